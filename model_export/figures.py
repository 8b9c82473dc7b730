"""Figures of an evaluation: error against SNR, separation and RT60, and the confidences' truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.progress import track

from model_export.evaluate import EVALUATION_SEED, SMALL_ROOM, Cell, run
from model_export.results import PEER
from model_export.rooms import RoomSpec
from model_export.simulate import Protocol, simulate_scene
from service.doa.presets import preset
from service.doa.scoring import match
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle
from service.inference.localizer import localizer_of

HIT_DEG = 10.0
BINS = np.linspace(0, 1, 11)
COLOURS = {"any-array": "#d1495b", PEER: "#1f2937", "srp_phat": "#2a9d8f", "music": "#9aa5b1"}


@dataclass(frozen=True, slots=True)
class Sweep:
    """One thing that varies while all else stays."""

    name: str
    label: str
    points: Mapping[float, Protocol]


def _room(rt60: float) -> RoomSpec:
    return RoomSpec(SMALL_ROOM.size, SMALL_ROOM.centre, rt60=rt60)


SWEEPS = (
    Sweep(
        "snr",
        "SNR in dB (one talker, the paper's room, order 4)",
        {snr: Protocol(snr_db=snr) for snr in (-5, 0, 5, 10, 15, 20, 30)},
    ),
    Sweep(
        "separation",
        "angle between two talkers in degrees (order 0 to 4, 30 dB)",
        {a: Protocol(num_sources=2, orders=(0, 4), separation_deg=a)
         for a in (15, 20, 30, 45, 60, 90, 135, 180)},
    ),
    Sweep(
        "rt60",
        "RT60 in seconds (one talker, 5 x 4 x 2.8 m, 20 dB)",
        {rt60: Protocol(room=_room(rt60), snr_db=20) for rt60 in (0.2, 0.3, 0.4, 0.5, 0.6)},
    ),
)  # fmt: skip


def draw(
    folder: Path, bundles: Sequence[Path], speech: Sequence[FloatArray], scenes: int
) -> list[Path]:
    """Write ``error-over-<sweep>.png`` and ``reliability.png`` with ``scenes`` scenes a point."""
    written = []
    for sweep in SWEEPS:
        path = folder / f"error-over-{sweep.name}.png"
        _sweep_figure(sweep, bundles, speech, scenes).savefig(path, dpi=130)
        written.append(path)
    path = folder / "reliability.png"
    _reliability_figure(*_reliability(bundles[0], speech, 4 * scenes)).savefig(path, dpi=130)
    return [*written, path]


def _sweep_figure(
    sweep: Sweep, bundles: Sequence[Path], speech: Sequence[FloatArray], scenes: int
) -> Figure:
    cells = [Cell(f"{sweep.name} {x:g}", protocol) for x, protocol in sweep.points.items()]
    results = run(bundles, speech, scenes, cells=cells)
    figure, axes = _axes(sweep.label, "mean absolute angular error in degrees")
    for method, colour in COLOURS.items():
        errors = [results.cells[cell.name][method]["maae_deg"] for cell in cells]
        axes.plot(list(sweep.points), errors, "o-", color=colour, label=method, lw=2)
    axes.set_yscale("log")
    axes.set_ylim(0.2, 100)
    axes.set_yticks([0.3, 1, 3, 10, 30, 90], ["0.3", "1", "3", "10", "30", "90"])
    axes.legend(frameon=False)
    axes.set_title(f"{scenes} scenes a point, held-out speakers, count known", fontsize=9)
    return figure


def _reliability(
    folder: Path, speech: Sequence[FloatArray], scenes: int
) -> tuple[FloatArray, FloatArray]:
    """Confidences of reported sources and whether each is within 10 degrees of a talker."""
    bundle = load_bundle(folder)
    localizer = localizer_of(bundle, preset("respeaker-usb-4mic-v2"))
    confidences: list[float] = []
    hits: list[bool] = []
    for index in track(range(scenes), description="reliability"):
        rng = np.random.default_rng([EVALUATION_SEED, 5, index])
        room = _room(float(rng.uniform(0.2, 0.6))) if index % 2 else None
        protocol = Protocol(
            num_sources=1 + index % 3, room=room, orders=(0, 4), snr_db=float(rng.uniform(-5, 30))
        )
        scene = simulate_scene(protocol, speech, [EVALUATION_SEED, 6, index])
        (estimate,) = localizer.estimate(scene.audio[None], None, 4)
        azimuths = np.array([source.azimuth for source in estimate.sources])
        near = {i for i, _, error in match(azimuths, scene.azimuth) if np.rad2deg(error) <= HIT_DEG}
        confidences += [source.confidence for source in estimate.sources]
        hits += [i in near for i in range(len(azimuths))]
    return np.array(confidences), np.array(hits, dtype=float)


def _reliability_figure(confidence: FloatArray, hit: FloatArray) -> Figure:
    figure, axes = _axes("confidence", f"share within {HIT_DEG:g} degrees of a talker")
    axes.plot([0, 1], [0, 1], ":", color="#9aa5b1")
    bins = np.clip(np.digitize(confidence, BINS) - 1, 0, len(BINS) - 2)
    for index in np.unique(bins):
        members = bins == index
        size = 20 + 300 * members.mean()
        axes.scatter(confidence[members].mean(), hit[members].mean(), s=size, color="#d1495b")
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02))
    axes.set_title(
        f"{len(hit)} reported sources, -5 to 30 dB, 1 to 3 talkers, count unknown; "
        "larger: more of them",
        fontsize=9,
    )
    return figure


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes
