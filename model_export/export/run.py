"""Export of a run folder to a bundle: its variant, the source count, the training record."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from model_export.export.bundle_place import check_replaceable, in_the_place_of
from model_export.export.parameters import (
    TrainedTask,
    known_networks,
    source_count_of,
    trained_task,
)
from model_export.export.regression import export_regression
from model_export.export.weights import candidate_search, export_weights
from model_export.simulation.room_bank import RoomBank
from model_export.training.counting import CandidateCountNetwork, collect, train_counting
from model_export.training.regression import RegressionTask
from model_export.training.weights_task import WeightsTask
from service.doa.types import FloatArray
from service.inference.bundle import MANIFEST, load_bundle, read_manifest
from service.inference.manifest import Manifest, Purpose

DESCRIPTIONS = {
    "weights": "Time-frequency weights from array-independent features: works on any array.",
    "regression": "The paper's networks for one array, to compare with: any-array is better there.",
}
PURPOSES: Mapping[str, Purpose] = {"weights": "localization", "regression": "comparison"}


def export_run(
    run: Path,
    out: Path,
    *,
    name: str | None,
    version: str,
    rooms: Path | None,
    speech: Sequence[FloatArray],
    validation_speech: Sequence[FloatArray],
    counting_scenes: int,
    source_count: Path | None = None,
    known: Sequence[Path] = (),
    noises: Sequence[FloatArray] = (),
    data: Sequence[str],
    licences: Sequence[str],
) -> Manifest:
    """Export the run's checkpoint as a bundle, after training a `weights` run's source count.

    ``rooms`` is the folder of the room bank on which the source count is trained, if it is.
    ``source_count`` is the folder of a bundle whose source count is used instead: the teacher's,
    for a distilled run, which gives the same candidates. ``known`` are runs or bundles with a
    `regression` bundle's networks for one number of talkers each. ``run`` may be a bundle as well.
    ``out`` may hold a bundle, which is replaced once the new one has passed its tests.

    Raises
    ------
    ValueError
        If ``out`` holds anything else, the run or a known one cannot be exported, or the exported
        networks differ from the trained ones.
    """
    check_replaceable(out)
    trained = trained_task(run)
    task, config = trained.task, trained.task.config
    if config.variant == "sscl":
        raise ValueError(f"{run} only pretrains an encoder: train 'paper' from it and export that")
    training = {**trained.record, "data": list(data)}
    fields = {
        "name": name or config.name,
        "version": version,
        "description": DESCRIPTIONS[config.variant],
        "purpose": PURPOSES[config.variant],
        "training": training,
        "scores": {},
        "licences": list(licences),
    }
    if isinstance(task, RegressionTask):
        tasks, records = known_tasks(task, known)
        if records:
            training["known"] = records
        with in_the_place_of(out) as folder:
            return export_regression(task, folder, fields, tasks)
    if known:
        raise ValueError(
            f"{run} is of the variant {config.variant}, one network for every number of talkers: "
            "leave --known out"
        )
    assert isinstance(task, WeightsTask)
    if source_count is not None:
        network = source_count_of(source_count)
        training["counting_from"] = read_manifest(source_count)[0].training["parameters"]
    else:
        if rooms is None:
            raise ValueError("the source count is trained in a room bank: name it with --rooms")
        network, scores = _count_sources(
            task, rooms, speech, validation_speech, noises, counting_scenes, config.seed
        )
        training["counting_scenes"] = counting_scenes
        training["counting_validation"] = {key: round(value, 4) for key, value in scores.items()}
    with in_the_place_of(out) as folder:
        return export_weights(task.model, network, folder, fields)


def known_tasks(
    task: RegressionTask, known: Sequence[Path]
) -> tuple[dict[int, RegressionTask], dict[str, Any]]:
    """The networks for one number of talkers each by that number, and their records.

    ``known`` are runs, and bundles, which give the numbers that no run has.

    Raises
    ------
    ValueError
        If a run is of another variant or of several numbers, two give the same number, a bundle has
        no such network, or an array or features differ from the task's.
    """
    networks: dict[int, TrainedTask] = {}
    bundles: dict[int, TrainedTask] = {}
    for folder in known:
        for count, trained in _known_in(folder).items():
            place = bundles if (folder / MANIFEST).exists() else networks
            if count in place:
                raise ValueError(f"{folder} is the second for {count} talkers: name one")
            place[count] = trained
    chosen = sorted({**bundles, **networks}.items())
    tasks: dict[int, RegressionTask] = {}
    for count, trained in chosen:
        assert isinstance(trained.task, RegressionTask)
        trained.task.config.check_features(task.config)
        tasks[count] = trained.task
    return tasks, {str(count): dict(trained.record) for count, trained in chosen}


def _known_in(folder: Path) -> dict[int, TrainedTask]:
    if (folder / MANIFEST).exists():
        networks = known_networks(load_bundle(folder))
        if not networks:
            raise ValueError(f"{folder} has no network for one number of talkers: leave it out")
        return networks
    trained = TrainedTask.of_run(folder)
    count = trained.task.config.scenes.known_count
    if not isinstance(trained.task, RegressionTask) or not count:
        raise ValueError(
            f"{folder} was not trained for one number of talkers: name runs of paper-1, paper-2 "
            "or paper-3"
        )
    return {count: trained}


def _count_sources(
    task: WeightsTask,
    rooms: Path,
    speech: Sequence[FloatArray],
    validation_speech: Sequence[FloatArray],
    noises: Sequence[FloatArray],
    scenes: int,
    seed: int,
) -> tuple[CandidateCountNetwork, dict[str, float]]:
    with tempfile.TemporaryDirectory() as folder:
        search = candidate_search(task.model, Path(folder))
        data = collect(search, RoomBank(rooms), speech, scenes, seed, noises=noises)
        bank = RoomBank(rooms, validation=True)
        fewer = max(16, scenes // 8)
        held = collect(search, bank, validation_speech, fewer, seed + 1, noises=noises)
    return train_counting(data, held)
