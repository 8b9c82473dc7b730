"""Score every bundle and the classical methods in one seeded run.

The scenes are the same for every method: their speakers were in no training, and their seeds
depend only on the cell's name and the scene's index.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path

from model_export.datasets.speech import Split
from model_export.evaluation.cells import CELLS, Cell
from model_export.evaluation.false_sources import NOISES, count_false_sources, recorded
from model_export.evaluation.methods import keep_better_band
from model_export.evaluation.reliability import measure_reliability
from model_export.evaluation.results import Results
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.arrays import named_array
from model_export.simulation.protocol import simulate_scene
from service.doa import scoring
from service.doa.types import FloatArray

SEEDS: Mapping[Split, int] = {"heldout": 7, "development": 8}
"""Seeds of the scenes; work on development speakers shows no scene of the published scores"""


@dataclass(frozen=True, slots=True)
class AnsweredScene:
    """Every method's estimates of one scene."""

    truth: FloatArray
    """(M,) radians"""
    found: Mapping[str, FloatArray]
    """Estimated azimuths in radians, by method"""
    voiced: bool


def evaluate(
    workers: Workers, scenes: int, *, pattern: str = "*", recordings: Sequence[Path] = ()
) -> Results:
    """The whole evaluation: the cells, the recordings without talkers and the reliability.

    Parameters
    ----------
    pattern : str
        Shell pattern (``*``) for the names of the cells and noises to run.
    recordings : sequence of Path
        Steady recordings without talkers to count false sources in, besides the synthetic ones.

    Raises
    ------
    ValueError
        If no name matches the pattern.
    """
    cells = [cell for cell in CELLS if fnmatchcase(cell.name, pattern)]
    noises = [n for n in (*NOISES, *recorded(recordings)) if fnmatchcase(n.name, pattern)]
    reliable = fnmatchcase("reliability", pattern)
    if not (cells or noises or reliable):
        raise ValueError(f"no cell matches {pattern!r}; the cells are {', '.join(_names())}")
    results = run(workers, scenes, cells=cells)
    results.cells.update(count_false_sources(workers, noises))
    if reliable:
        results.reliability = measure_reliability(workers, 2 * scenes)
    return results


def _names() -> list[str]:
    return [*(cell.name for cell in CELLS), *(noise.name for noise in NOISES), "reliability"]


def run(workers: Workers, scenes: int, *, cells: Sequence[Cell] = CELLS) -> Results:
    """Score all methods on ``scenes`` scenes a cell, without those in which a talker is silent."""
    tasks = [(cell, index) for cell in cells for index in range(scenes)]
    answered = iter(workers.map(answer_scene, tasks, "scenes"))
    results = Results(scenes, workers.inputs.seed)
    for cell in cells:
        windows = [scene for scene in islice(answered, scenes) if scene.voiced]
        if not windows:
            raise ValueError(f"{cell.name}: nobody speaks in any window: simulate more scenes")
        truths = [scene.truth for scene in windows]
        results.cells[cell.name] = {
            name: scoring.evaluate([scene.found[name] for scene in windows], truths)
            for name in windows[0].found
        }
        keep_better_band(results.cells[cell.name])
        results.protocols[cell.name] = {
            **asdict(cell.protocol),
            "count_known": cell.count_known,
            "positions_m": named_array(cell.protocol.array).positions.tolist(),
            "windows": len(windows),
        }
    return results


def answer_scene(inputs: Inputs, task: tuple[Cell, int]) -> AnsweredScene:
    """Simulate one scene of a cell and localize it with every method that fits its array."""
    cell, index = task
    seed = [inputs.seed, zlib.crc32(cell.name.encode()), index]
    scene = simulate_scene(cell.protocol, inputs.speech, seed)
    known = cell.protocol.num_sources if cell.count_known else None
    answers = inputs.methods.answers(scene.array)
    found = {name: answer(scene, known) for name, answer in answers.items()}
    return AnsweredScene(scene.azimuth, found, scene.voiced)
