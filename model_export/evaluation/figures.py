"""Figures of an evaluation: error against SNR, separation and RT60, and reliability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from model_export.evaluation.bars import JUDGED
from model_export.evaluation.cells import Cell, small_room
from model_export.evaluation.drawing import axes
from model_export.evaluation.evaluate import run
from model_export.evaluation.methods import PEER
from model_export.evaluation.reliability import Reliability
from model_export.evaluation.results import Results
from model_export.evaluation.workers import Workers
from model_export.simulation.protocol import SceneProtocol
from model_export.training.confidences import HIT_DEG

COLOURS = {
    "any-array": "#d1495b",
    "paper": "#e9a23b",
    PEER: "#1f2937",
    "gcc_phat": "#5b5f97",
    "srp_phat": "#2a9d8f",
    "music": "#9aa5b1",
}


@dataclass(frozen=True, slots=True)
class Sweep:
    """Scenes in which one parameter varies."""

    name: str
    label: str
    points: Mapping[float, SceneProtocol]


SWEEPS = (
    Sweep(
        "snr",
        "SNR in dB (one talker, the paper's room, order 4)",
        {snr: SceneProtocol(snr_db=snr) for snr in (-5, 0, 5, 10, 15, 20, 30)},
    ),
    Sweep(
        "separation",
        "angle between two talkers in degrees (order 0 to 4, 30 dB)",
        {a: SceneProtocol(num_sources=2, orders=(0, 4), separation_deg=a)
         for a in (15, 20, 30, 45, 60, 90, 135, 180)},
    ),
    Sweep(
        "rt60",
        "RT60 in seconds (one talker, 5 x 4 x 2.8 m, 20 dB)",
        {rt60: SceneProtocol(room=small_room(rt60), snr_db=20)
         for rt60 in (0.2, 0.3, 0.4, 0.5, 0.6)},
    ),
)  # fmt: skip


def draw(folder: Path, workers: Workers, scenes: int, results: Results) -> list[Path]:
    """Write ``error-over-<sweep>.png`` with ``scenes`` scenes a point, and ``reliability.png``."""
    written = []
    for sweep in SWEEPS:
        path = folder / f"error-over-{sweep.name}.png"
        _sweep_figure(sweep, workers, scenes).savefig(path, dpi=130)
        written.append(path)
    if JUDGED in results.reliability:
        path = folder / "reliability.png"
        _reliability_figure(results.reliability[JUDGED]).savefig(path, dpi=130)
        written.append(path)
    return written


def _sweep_figure(sweep: Sweep, workers: Workers, scenes: int) -> Figure:
    cells = [Cell(f"{sweep.name} {x:g}", protocol) for x, protocol in sweep.points.items()]
    swept = run(workers, scenes, cells=cells)
    figure, panel = axes(sweep.label, "mean absolute angular error in degrees")
    for method in swept.cells[cells[0].name]:
        if method in COLOURS:
            errors = [swept.cells[cell.name][method]["maae_deg"] for cell in cells]
            points = list(sweep.points)
            panel.plot(points, errors, "o-", color=COLOURS[method], label=method, lw=2)
    panel.set_yscale("log")
    panel.set_ylim(0.2, 100)
    panel.set_yticks([0.3, 1, 3, 10, 30, 90], ["0.3", "1", "3", "10", "30", "90"])
    panel.legend(frameon=False)
    panel.set_title(f"{scenes} scenes a point, held-out speakers, count known", fontsize=9)
    return figure


def _reliability_figure(reliability: Reliability) -> Figure:
    figure, panel = axes("confidence", f"share within {HIT_DEG:g} degrees of a talker")
    panel.plot([0, 1], [0, 1], ":", color="#9aa5b1")
    for bin_ in reliability.bins:
        size = 20 + 300 * bin_.sources / reliability.sources
        panel.scatter(bin_.mean_confidence, bin_.share_right, s=size, color="#d1495b")
    panel.set(xlim=(0, 1.02), ylim=(0, 1.02))
    panel.set_title(
        f"{reliability.sources} reported sources, -5 to 30 dB, 1 to 3 talkers, count unknown; "
        "larger: more of them",
        fontsize=9,
    )
    return figure
