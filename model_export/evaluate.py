"""Score every bundle and the classical methods on one seeded protocol.

The scenes are the same for every method: held-out speakers, the paper's room and some that it never
names, seeds fixed by the cell's name. pyroomacoustics' NormMUSIC is run as its users should run
it, with its own circular peaks, in two bands of which the better one counts.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyroomacoustics as pra
from rich.progress import track

from model_export.results import PEER, Results
from model_export.rooms import RoomSpec
from model_export.simulate import Protocol, SimulatedScene, simulate_scene
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import evaluate
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import localizer_of
from service.inference.results import METHODS

EVALUATION_SEED = 7
BANDS = ((300.0, 3500.0), (100.0, 7900.0))
"""Hertz, of pyroomacoustics' NormMUSIC"""
SMALL_ROOM = RoomSpec((5.0, 4.0, 2.8), (2.2, 1.8, 1.1), rt60=0.35)
LARGE_ROOM = RoomSpec((10.0, 8.0, 3.5), (4.2, 3.6, 1.2), rt60=0.6)


@dataclass(frozen=True, slots=True)
class Cell:
    """One column of the results table."""

    name: str
    protocol: Protocol
    count_known: bool = True


CELLS = (
    Cell("M=1, order 4, 30 dB", Protocol()),
    Cell("M=1, order 4, 0 dB", Protocol(snr_db=0.0)),
    Cell("M=2, order 4, 30 dB", Protocol(num_sources=2)),
    Cell("M=2, order 0-4, 30 dB", Protocol(num_sources=2, orders=(0, 4))),
    Cell("M=1, order 4, 30 dB, count unknown", Protocol(), count_known=False),
    Cell("M=2, order 4, 30 dB, count unknown", Protocol(num_sources=2), count_known=False),
    Cell("M=1, 5x4x2.8 m, RT60 0.35 s", Protocol(room=SMALL_ROOM)),
    Cell("M=1, 10x8x3.5 m, RT60 0.6 s", Protocol(room=LARGE_ROOM)),
    Cell("M=1, order 4, 6-mic circular", Protocol(array="respeaker-6mic-circular")),
    Cell("M=1, order 4, 8-mic circle r 10 cm", Protocol(array="av163-circle8")),
)

Answer = Callable[[SimulatedScene, int | None], FloatArray]
"""A scene and its known count, or None, to azimuths in radians"""


def run(
    bundles: Sequence[Path],
    speech: Sequence[FloatArray],
    scenes: int,
    *,
    cells: Sequence[Cell] = CELLS,
) -> Results:
    """Score all methods on ``scenes`` scenes a cell."""
    results = Results(scenes, EVALUATION_SEED)
    for cell in cells:
        methods = answers(bundles, preset(cell.protocol.array))
        seed = zlib.crc32(cell.name.encode())
        truths: list[FloatArray] = []
        found: dict[str, list[FloatArray]] = {name: [] for name in methods}
        for index in track(range(scenes), description=cell.name):
            scene = simulate_scene(cell.protocol, speech, [EVALUATION_SEED, seed, index])
            known = cell.protocol.num_sources if cell.count_known else None
            truths.append(scene.azimuth)
            for name, answer in methods.items():
                found[name].append(answer(scene, known))
        results.cells[cell.name] = {name: evaluate(f, truths) for name, f in found.items()}
        results.protocols[cell.name] = asdict(cell.protocol)
        _keep_better_band(results.cells[cell.name])
    return results


def answers(bundles: Sequence[Path], array: MicrophoneArray) -> dict[str, Answer]:
    """Every method that can answer for this array."""
    methods: dict[str, Answer] = {}
    for folder in bundles:
        bundle = load_bundle(folder)
        if bundle.fits(array):
            methods[bundle.manifest.name] = _localizer_answer(localizer_of(bundle, array))
    for method in METHODS:
        if method != "neural":
            methods[method] = _localizer_answer(ClassicalLocalizer(method, array))
    for band in BANDS:
        methods[_band_name(band)] = _pyroomacoustics(array, band)
    return methods


def _localizer_answer(localizer: Any) -> Answer:
    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        (estimate,) = localizer.estimate(scene.audio[None], known, 3)
        return np.array([source.azimuth for source in estimate.sources])

    return answer


def _pyroomacoustics(array: MicrophoneArray, band: tuple[float, float]) -> Answer:
    stft = Stft()

    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        # It must be told a count; where ours is not told either, it is told the truth.
        count = known or len(scene.azimuth)
        method = pra.doa.algorithms["NormMUSIC"](
            array.positions.T, stft.sample_rate, stft.n_fft, num_src=count, n_grid=360, dim=2
        )
        method.locate_sources(stft.transform(scene.audio), freq_range=list(band))
        azimuth: FloatArray = np.atleast_1d(method.azimuth_recon)
        return azimuth[:count]

    return answer


def _band_name(band: tuple[float, float]) -> str:
    return f"{PEER} {band[0]:.0f}-{band[1]:.0f} Hz"


def _keep_better_band(scores: dict[str, dict[str, float]]) -> None:
    """Of pyroomacoustics' bands only the one with the smaller MAAE stays, as its one row."""
    bands = [scores.pop(_band_name(band)) for band in BANDS]
    scores[PEER] = min(bands, key=lambda s: s["maae_deg"])
