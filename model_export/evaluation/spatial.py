"""Talkers above and below arrays with height: the command ``spatial``.

The errors are great-circle angles. Networks and the service's classical methods are scored beside
pyroomacoustics' NormMUSIC and SRP-PHAT on its own grid of the sphere, in one run.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyroomacoustics as pra

from model_export.baselines.told import STFT
from model_export.evaluation.cells import Cell, living_room
from model_export.evaluation.methods import PEER
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.arrays import SPATIAL_ARRAYS
from model_export.simulation.protocol import SceneProtocol, SimulatedScene, simulate_scene
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.scoring import match_directions
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.classical import BAND, ClassicalLocalizer
from service.inference.localizer import Localizer
from service.recordings.results import DEFAULT_MAX_SOURCES

ELEVATIONS_DEG = (-60.0, 80.0)
GRID = 5000
"""Points of pyroomacoustics' grid, 3 degrees apart"""
HIT_DEG = 10.0
RESAMPLES = 1000
SECTION = "spatial"

Answer = Callable[[SimulatedScene, int | None], FloatArray]
"""Unit vectors (K, 3), most confident first, for a scene and its known count or None"""


def spatial_cells() -> list[Cell]:
    """One talker, told, and two at least 30 degrees apart, to be counted; 20 dB."""
    return [
        Cell(
            f"{array}, {talkers} talker{'s' * (talkers > 1)}, RT60 {rt60:g} s",
            SceneProtocol(
                num_sources=talkers,
                array=array,
                room=living_room(rt60),
                snr_db=20.0,
                elevations_deg=ELEVATIONS_DEG,
                min_separation_deg=30.0,
            ),
            count_known=talkers == 1,
        )
        for talkers in (1, 2)
        for array in SPATIAL_ARRAYS
        for rt60 in (0.3, 0.6)
    ]


@dataclass(frozen=True, slots=True)
class AnsweredScene:
    """The errors of every method in one scene."""

    errors: Mapping[str, FloatArray]
    """(M,) degrees from each talker to its match, 90 where it has none, by method"""
    counted: Mapping[str, bool]
    """Whether the number of sources is right, by method"""
    voiced: bool


def answer_scene(inputs: Inputs, task: tuple[Cell, int]) -> AnsweredScene:
    """Simulate one scene of a cell and localize it with every method."""
    cell, index = task
    seed = [inputs.seed, zlib.crc32(cell.name.encode()), index]
    scene = simulate_scene(cell.protocol, inputs.speech, seed)
    known = cell.protocol.num_sources if cell.count_known else None
    truth = unit_vectors(scene.azimuth, scene.elevation)
    found = {name: answer(scene, known) for name, answer in _answers(inputs, scene.array).items()}
    return AnsweredScene(
        {name: errors_deg(each, truth) for name, each in found.items()},
        {name: len(each) == len(truth) for name, each in found.items()},
        scene.voiced,
    )


def errors_deg(found: FloatArray, truth: FloatArray) -> FloatArray:
    """Degrees (M,) from every talker (M, 3) to its match among directions (K, 3); 90 without."""
    errors = np.full(len(truth), 90.0)
    for _, talker, error in match_directions(found.reshape(-1, 3), truth):
        errors[talker] = np.rad2deg(error)
    return errors


def measure_spatial(workers: Workers, scenes: int, cells: Sequence[Cell]) -> str:
    """The tables of all cells, ``scenes`` scenes each."""
    tables = []
    for cell in cells:
        tasks = [(cell, index) for index in range(scenes)]
        answered = [a for a in workers.map(answer_scene, tasks, cell.name) if a.voiced]
        if not answered:
            raise ValueError(f"{cell.name}: nobody speaks in any window: simulate more scenes")
        tables.append(_table(cell, answered))
    return "\n\n".join(tables)


def document(tables: str, scenes: int, split: str) -> str:
    """The section of ``docs/results.md``."""
    return (
        "## Talkers above and below\n\n"
        f"Written by `python -m model_export spatial`: {scenes} scenes a cell, {split} speakers, "
        "elevations -60 to 80 degrees, 20 dB; errors are great-circle angles, of the matched "
        "talkers, and 90 degrees where one has no match. Two talkers are counted by the service's "
        f"methods; {PEER} and SRP-PHAT are told how many there are, on {GRID} directions, 300 to "
        "3500 Hz. In brackets: 95 % of "
        f"{RESAMPLES} resamples of the scenes.\n\n{tables}\n"
    )


def _table(cell: Cell, answered: Sequence[AnsweredScene]) -> str:
    lines = [
        f"**{cell.name}**, {len(answered)} windows",
        "",
        "| method | median | mean | within 10° | missed | count right |",
        "|---|---|---|---|---|---|",
    ]
    for name in answered[0].errors:
        errors = np.array([scene.errors[name] for scene in answered])  # (S, M)
        counted = np.mean([scene.counted[name] for scene in answered])
        lines.append(
            f"| {name} | {_interval(errors, np.median)}° | {_interval(errors, np.mean)}° "
            f"| {100 * (errors <= HIT_DEG).mean():.0f} % | {100 * (errors > HIT_DEG).mean():.0f} % "
            f"| {100 * counted:.0f} % |"
        )
    return "\n".join(lines)


def _interval(errors: FloatArray, statistic: Callable[[FloatArray], np.floating]) -> str:
    """A statistic of errors (S, M), with the interval over resampled scenes."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(errors), size=(RESAMPLES, len(errors)))
    low, high = np.percentile([float(statistic(errors[rows])) for rows in drawn], [2.5, 97.5])
    return f"{float(statistic(errors)):.1f} ({low:.1f} to {high:.1f})"


_prepared: dict[tuple[int, str], dict[str, Answer]] = {}


def _answers(inputs: Inputs, array: MicrophoneArray) -> dict[str, Answer]:
    key = (id(inputs), array.name)
    if key not in _prepared:
        localizers: dict[str, Localizer] = dict(inputs.methods.localizers(array))
        localizers["norm_music"] = ClassicalLocalizer("norm_music", array)
        localizers["srp_phat"] = ClassicalLocalizer("srp_phat", array)
        _prepared[key] = {
            **{name: _of_localizer(localizer) for name, localizer in localizers.items()},
            PEER: _pyroomacoustics("NormMUSIC", array),
            "pyroomacoustics SRP-PHAT": _pyroomacoustics("SRP", array),
        }
    return _prepared[key]


def _of_localizer(localizer: Localizer) -> Answer:
    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        (estimate,) = localizer.estimate(scene.audio[None], known, DEFAULT_MAX_SOURCES)
        angles = [(source.azimuth, source.elevation or 0.0) for source in estimate.sources]
        azimuth, elevation = np.array(angles).reshape(-1, 2).T
        return unit_vectors(azimuth, elevation)

    return answer


def _pyroomacoustics(name: str, array: MicrophoneArray) -> Answer:
    centred = array.positions - array.positions.mean(axis=0)
    finder = pra.doa.algorithms[name](
        centred.T, STFT.sample_rate, STFT.n_fft, c=SPEED_OF_SOUND, dim=3, n_grid=GRID
    )

    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        # It requires a count; where the count is unknown to the others, it is told the truth.
        count = known or len(scene.azimuth)
        spectra = STFT.transform(scene.audio)
        finder.locate_sources(spectra, num_src=count, freq_range=list(BAND))
        azimuth = np.atleast_1d(finder.azimuth_recon)[:count]
        return unit_vectors(azimuth, np.pi / 2 - np.atleast_1d(finder.colatitude_recon)[:count])

    return answer
