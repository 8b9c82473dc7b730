"""The main table on recordings: the paper's other data sets, once they are downloaded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from types import MappingProxyType

import numpy as np

from model_export.baselines.catalogue import classical
from model_export.datasets.afpild import AFPILD
from model_export.datasets.av163 import AV163
from model_export.datasets.item import Dataset, DatasetItem
from model_export.datasets.locata import LOCATA
from model_export.datasets.offset import learn_offset
from model_export.datasets.sloclas import SLoClas
from model_export.experiments import paper
from model_export.experiments.cells import Cell
from model_export.experiments.contenders import classical_contenders, matched_contenders, title
from model_export.experiments.outcome import Outcome, Table
from model_export.experiments.scene_set import SceneSet, is_whole
from model_export.experiments.study import Study
from model_export.simulation.scenes import WINDOW_SAMPLES
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

HOP_SAMPLES = WINDOW_SAMPLES // 2
OFFSET_ITEMS = 500
"""Number of training items that give the angle between the annotations' zero and the array's"""


@dataclass(frozen=True, slots=True)
class RecordingSet:
    """One data set in the experiment."""

    title: str
    open: Callable[[Path], Dataset]
    train: str
    test: str
    zero_known: bool = True
    """Whether annotations are in the array's frame"""
    reported: tuple[str, ...] = ()
    """The paper's columns for one, two, ... sources"""


TASKS: Mapping[str, RecordingSet] = MappingProxyType(
    {
        "av163": RecordingSet(
            "AV16.3, array 1", partial(AV163, arrays="1"), "train", "test",
        ),
        "av163-both": RecordingSet(
            "AV16.3, both arrays", AV163, "train", "test",
            reported=("AV16.3 M=1", "AV16.3 M=2"),
        ),
        "sloclas": RecordingSet(
            "SLoClas", SLoClas, "train", "test", zero_known=False,
            reported=("SLoClas",),
        ),
        "afpild": RecordingSet(
            "AFPILD", AFPILD, "train", "test", zero_known=False,
            reported=("AFPILD",),
        ),
        "locata": RecordingSet("LOCATA", LOCATA, "dev", "eval"),
    }
)  # fmt: skip


def recordings(study: Study, name: str, folder: Path) -> Outcome:
    """Every method on one data set, trained on its training split and scored on its test split.

    Raises
    ------
    ValueError
        If a file of the data set is wrong; the message names it.
    """
    task = TASKS[name]
    train = f"{name} train"
    counts = _cut(study, name, task, folder)
    cells = {count: Cell(f"{name} test-{count}") for count in counts}
    contenders = study.only([*classical_contenders(), *matched_contenders(scenes=train)])
    scores = study.scored(contenders, list(cells.values()))
    columns = task.reported
    rows = tuple(
        (
            title(each.label),
            *(scores[each.label][cell]["maae_deg"] for cell in cells.values()),
            *(paper.RECORDINGS.get(each.label, {}).get(column) for column in columns),
        )
        for each in contenders
    )
    text = (
        f"{task.title}: windows of {WINDOW_SAMPLES / 16000:.2f} s of the test split by the number "
        "of sources, error in degrees with the number known; networks are trained on the training "
        "split. Further white noise is part of the training only."
    )
    headings = (*(f"M={count}" for count in cells), *(f"paper {column}" for column in columns))
    return Outcome(text, (Table(("method", *headings), rows),))


def _cut(study: Study, name: str, task: RecordingSet, folder: Path) -> list[int]:
    """Write scene sets of both splits; returns the test split's numbers of sources."""
    dataset = task.open(folder)
    first = next(dataset.items(task.train))
    offset = 0.0 if task.zero_known else _zero(dataset.items(task.train))
    place = study.folder / "scenes"
    if not is_whole(place / f"{name} train"):
        scenes = _windows(dataset.items(task.train), offset)
        SceneSet.write(place / f"{name} train", scenes, first.array)
    counts = []
    for count in (1, 2, 3):
        part = place / f"{name} test-{count}"
        if not is_whole(part):
            scenes = (w for w in _windows(dataset.items(task.test), offset) if len(w[1]) == count)
            found = next(scenes, None)
            if found is None:
                continue
            SceneSet.write(part, chain([found], scenes), first.array)
        counts.append(count)
    return counts


def _windows(
    items: Iterable[DatasetItem], offset: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Windows with their directions in the array's frame; a shorter item is one padded window."""
    for item in items:
        length = min(WINDOW_SAMPLES, item.audio.shape[1])
        for audio, azimuth in item.windows(length, HOP_SAMPLES):
            yield audio, (azimuth + offset) % (2 * np.pi)


def _zero(items: Iterable[DatasetItem]) -> float:
    """The angle between the annotations' zero and the array's, by NormMUSIC on training items."""
    still = (item for item in items if item.directions.azimuth.shape == (1, 1))
    return learn_offset(islice(still, OFFSET_ITEMS), _norm_music)


def _norm_music(audio: FloatArray, array: MicrophoneArray) -> float:
    method = classical()["norm_music"]
    return float(method.localize(audio, array, 1).azimuth[0])
