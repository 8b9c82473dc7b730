"""One run of the experiments on disk: scene sets, trainings and scores, each computed once."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from model_export.baselines.catalogue import classical, network
from model_export.baselines.method import Method
from model_export.baselines.network import LearnedMethod
from model_export.baselines.neuralmusic import CovarianceTrunk
from model_export.baselines.shipped import shipped
from model_export.datasets.speech import load, speech_commands
from model_export.experiments.augmentation import white_noise
from model_export.experiments.cells import Cell, recipes
from model_export.experiments.scale import SCALES, Scale
from model_export.experiments.scene_set import SceneSet, is_whole, simulated
from model_export.experiments.training import (
    TUNING_RATE,
    Budget,
    Training,
    describe,
    fit,
    parameters,
    pretrain,
)
from service.doa import scoring
from service.doa.mirror import into_searched_half
from service.doa.types import FloatArray

SEED = 1
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Environment of each worker; the workers share the machine's CPUs"""


@dataclass(frozen=True, slots=True)
class Contender:
    """A method in a table: a classical one or a shipped bundle by its name, or a training."""

    label: str
    """Name of the method in the catalogue, and its variant"""
    training: Training | None = None

    @property
    def key(self) -> str:
        """A name for files; a bundle's depends on its contents, too."""
        if self.training:
            return self.training.key
        bundle = shipped().get(self.label)
        return f"{self.label}-{bundle.sha256[:12]}" if bundle else self.label

    @property
    def name(self) -> str:
        """The method's name in the catalogue."""
        return self.training.method if self.training else self.label

    @property
    def counts(self) -> bool:
        """Whether it estimates the number of sources itself."""
        return self.label not in classical()


Scores = dict[str, float]
"""Scores of ``scoring.evaluate``, and ``cpu_ms`` a window"""


@dataclass(frozen=True, slots=True)
class Study:
    """The folder of a scale's work and the settings of that work."""

    folder: Path
    scale_name: str
    speech: Path
    """Folder of Speech Commands"""
    workers: int = 1
    device: str = "cpu"
    """Device that networks are trained on; estimates are always computed on the CPU"""
    methods: tuple[str, ...] = ()
    """Names in the catalogue of the methods that are compared; empty means all"""

    @property
    def scale(self) -> Scale:
        return SCALES[self.scale_name]

    def scenes(self, name: str) -> SceneSet:
        """A scene set that ``simulate`` has made."""
        return SceneSet.read(self.folder / "scenes" / name)

    def simulate(self, names: Iterable[str]) -> None:
        """Make the scene sets that are missing."""
        known = recipes(self.scale)
        for name in dict.fromkeys(names):
            folder = self.folder / "scenes" / name
            if not is_whole(folder):
                speech = load(speech_commands(self.speech, known[name].split))
                simulated(folder, known[name], speech, self.workers)

    def train(self, trainings: Iterable[Training]) -> None:
        """Run the trainings that are missing, and those that they start from."""
        wanted = list(dict.fromkeys(trainings))
        bases = [replace(training, tuned_to=None) for training in wanted]
        self.simulate(
            name for each in wanted for name in (each.scenes, each.tuned_to) if name is not None
        )
        first = {each.scenes: None for each in wanted if each.pretrained}
        self._work(_pretrain, [(self, name) for name in first], "self-supervised")
        self._work(_train, [(self, each) for each in dict.fromkeys(bases)], "training")
        tuned = [each for each in wanted if each.tuned_to]
        self._work(_train, [(self, each) for each in tuned], "fine-tuning")

    def scored(
        self, contenders: Sequence[Contender], cells: Sequence[Cell]
    ) -> dict[str, dict[Cell, Scores]]:
        """Every contender's scores in every cell, by its label."""
        self.simulate(cell.scenes for cell in cells)
        self.train(each.training for each in contenders if each.training)
        asked = [(self, each, _told(each, cell)) for each in contenders for cell in cells]
        tasks = list(dict.fromkeys(asked))
        found = dict(zip(tasks, self._work(_score, tasks, "scoring"), strict=True))
        return {
            each.label: {cell: found[self, each, _told(each, cell)] for cell in cells}
            for each in contenders
        }

    def only(self, contenders: Sequence[Contender]) -> list[Contender]:
        """Select the contenders whose methods are asked for."""
        return [each for each in contenders if not self.methods or each.name in self.methods]

    def run(self, training: Training) -> Path:
        """The folder of a training."""
        return self.folder / "trainings" / training.key

    def pretraining(self, scenes: str) -> Path:
        """The folder of a self-supervised stage."""
        return self.folder / "pretrainings" / scenes

    def method(self, contender: Contender) -> Method:
        """The contender, ready to answer."""
        if contender.training is None:
            return {**classical(), **shipped()}[contender.label]
        fresh = _fresh(self, contender.training)
        fresh.load_state_dict(parameters(self.run(contender.training)))
        return LearnedMethod(fresh)

    def _work(self, job: Callable[[Any], Any], tasks: Sequence[Any], description: str) -> list[Any]:
        """Run a job on all tasks under a progress bar; results are in the tasks' order."""
        if not tasks:
            return []
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns) as progress:
            bar = progress.add_task(description, total=len(tasks))
            if self.workers == 1 or len(tasks) < 2:
                results = []
                for task in tasks:
                    results.append(job(task))
                    progress.advance(bar)
                return results
            # Fresh processes read their number of threads from the environment.
            os.environ.update(ONE_THREAD)
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(self.workers, context, initializer=_single_thread) as pool:
                futures = [pool.submit(job, task) for task in tasks]
                for future in futures:
                    future.add_done_callback(lambda _: progress.advance(bar))
                return [future.result() for future in futures]


def _single_thread() -> None:
    torch.set_num_threads(1)


def _fresh(study: Study, training: Training) -> Any:
    torch.manual_seed(SEED)
    array = study.scenes(training.scenes).array
    return network(
        training.method,
        training.track,
        array.num_microphones,
        reduced=study.scale.reduced,
        attention=training.attention,
    )


def _silent(step: int, steps: int, loss: float) -> None:
    """Report nothing: one bar shows the progress of all trainings."""


def _pretrain(task: tuple[Study, str]) -> None:
    study, name = task
    budget = Budget(study.scale.pretraining_epochs, study.scale.batch_size)
    pretrain(study.scenes(name), budget, study.pretraining(name), SEED, _silent, study.device)


def _train(task: tuple[Study, Training]) -> None:
    study, training = task
    scale, run, fresh = study.scale, study.run(training), _fresh(study, training)
    if training.tuned_to:
        fresh.load_state_dict(parameters(study.run(replace(training, tuned_to=None))))
        scenes = study.scenes(training.tuned_to)
        budget = Budget(scale.tuning_epochs, scale.batch_size, TUNING_RATE)
    else:
        scenes = study.scenes(training.scenes)
        budget = Budget(scale.epochs, scale.batch_size)
        if training.share < 1:
            scenes = scenes.share(training.share, SEED)
    if training.pretrained and not training.tuned_to:
        _take_encoder(fresh.trunk, study.pretraining(training.scenes))
    describe(run, training, budget)
    fit(fresh, scenes, budget, run, SEED, _silent, study.device)


def _take_encoder(trunk: CovarianceTrunk, pretraining: Path) -> None:
    """Copy every parameter and statistic of the self-supervised encoder."""
    state, prefix = parameters(pretraining), "encoder."
    trunk.encoder.load_state_dict(
        {name[len(prefix) :]: value for name, value in state.items() if name.startswith(prefix)}
    )


def _told(contender: Contender, cell: Cell) -> Cell:
    """The cell for a contender: one that cannot count knows the count everywhere."""
    return cell if contender.counts else replace(cell, count_known=True)


def _score(task: tuple[Study, Contender, Cell]) -> Scores:
    study, contender, cell = task
    path = study.folder / "scores" / cell.key / f"{contender.key}.json"
    if path.exists():
        scores: Scores = json.loads(path.read_text())
        return scores
    scores = score(study.method(contender), study.scenes(cell.scenes), cell)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(scores) + "\n")
    return scores


def score(method: Method, scenes: SceneSet, cell: Cell) -> Scores:
    """A method's scores on a set.

    For a line of microphones, truth and estimates are mapped to one side of it.
    """
    found, truth, spent = [], [], []
    for index in range(min(len(scenes), cell.first or len(scenes))):
        sources = scenes.sources(index)
        told = len(sources) if cell.count_known else None
        audio = heard(scenes, index, cell.snr_db)
        begun = time.process_time()
        found.append(method.localize(audio, scenes.array, told).azimuth)
        spent.append(time.process_time() - begun)
        truth.append(into_searched_half(scenes.array, sources))
    scores = scoring.evaluate(found, truth)
    return {**scores, "cpu_ms": 1000 * float(np.median(spent)), "scenes": float(len(found))}


def heard(scenes: SceneSet, index: int, snr_db: float | None) -> FloatArray:
    """One scene's window (N, T), with further noise if an SNR is given."""
    window = scenes.window(index)
    if snr_db is None:
        return window
    return white_noise(np.random.default_rng([SEED, index]), window, snr_db)
