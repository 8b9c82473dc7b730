"""Training: resumable, with curves in CSV, the configuration and the seed on disk.

A run folder holds ``config.json``, ``curves.csv`` and ``checkpoint.pt``; the same run started again
continues at its last checkpoint.
"""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch.utils.data import DataLoader

from model_export.training.config import TrainingConfig
from model_export.training.fitting import CHECKPOINT, Fitting, checkpoint
from model_export.training.reparametrize import merge
from model_export.training.scene_stream import SceneSource, SceneStream
from model_export.training.task import Batch, Task
from model_export.training.variants import collate, task_of

VALIDATION_BATCH = 16
"""Scenes"""
VALIDATION_SEED = 10**6
LOG_STEPS = 500
WARM_UP = 200
"""Steps in which the learning rate rises"""


def train(
    config: TrainingConfig,
    run: Path,
    scenes: SceneSource,
    validation_scenes: SceneSource,
    *,
    init: Task[Any] | None = None,
    workers: int = 1,
    device: str = "cpu",
) -> Task[Any]:
    """Train until ``config.steps``, continuing from the run folder's checkpoint if there is one.

    ``init`` is the task of the run that ``config.starts_from`` names, or one of the same kind to
    train further. A run may be resumed on another ``device``. Without ``workers`` scenes are made
    between the steps.

    Returns
    -------
    task : Task
        Task with the trained model on the CPU, in evaluation mode, merged into the text's network.
    """
    run.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    task = task_of(config)
    _start_from(config, task, init)
    task.model.to(device)
    optimizer = torch.optim.AdamW(
        task.model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    _describe(run, config)
    fitting = Fitting(task.model, optimizer, config.steps, WARM_UP, run)
    if fitting.step >= config.steps:
        return _finished(task)
    stream = SceneStream(config, scenes, first_step=fitting.step)
    prefetched = 4 if workers else None
    loader = iter(
        DataLoader(stream, batch_size=None, num_workers=workers, prefetch_factor=prefetched)
    )
    validation = [b.to(device) for b in _validation_batches(config, validation_scenes)]
    running: dict[str, float] = {}
    with _progress(config, fitting.step) as tell:
        while fitting.step < config.steps:
            losses = _optimize(fitting, task, next(loader).to(device))
            for name, value in losses.items():
                running[name] = 0.98 * running.get(name, value) + 0.02 * value
            tell(fitting, running["loss"])
            if fitting.step % config.checkpoint_every == 0 or fitting.step == config.steps:
                scores = _validate(task, validation)
                tell(fitting, running["loss"], scores)
                _write_curves(run, fitting.step, running, scores)
                fitting.save()
    return _finished(task)


def _finished(task: Task[Any]) -> Task[Any]:
    merge(task.model)
    task.model.cpu().eval()
    return task


def _start_from(config: TrainingConfig, task: Task[Any], init: Task[Any] | None) -> None:
    """Load the parameters that the task takes over from the one that it starts from."""
    if init is None:
        if config.starts_from is not None:
            raise ValueError(
                f"{config.name} starts from {config.starts_from}: name its run as init, or start "
                "from scratch"
            )
        return
    if init.config.name != config.starts_from and init.config.variant != config.variant:
        raise ValueError(f"{config.name} starts from {config.starts_from}, not {init.config.name}")
    try:
        task.start_from(init)
    except RuntimeError as error:  # load_state_dict's
        raise ValueError(f"{init.config.name} does not fit {config.name}: {error}") from error


def load_run(run: Path) -> tuple[TrainingConfig, Task[Any], int]:
    """A run's configuration, its task with the checkpoint's parameters, merged, and the step."""
    if not (run / CHECKPOINT).exists():
        raise FileNotFoundError(f"{run} holds no {CHECKPOINT}: train first")
    config = TrainingConfig.from_dict(json.loads((run / "config.json").read_text()))
    task = task_of(config)
    state = checkpoint(run)
    task.model.load_state_dict(state["model"])
    return config, _finished(task), int(state["step"])


def _optimize(fitting: Fitting, task: Task[Any], batch: Batch) -> dict[str, float]:
    task.model.train()
    losses = task.losses(batch)
    fitting.optimize(losses["loss"])
    return {name: float(value.detach()) for name, value in losses.items()}


def _validate(task: Task[Any], batches: Sequence[Batch]) -> dict[str, float]:
    """Means of all scores, and medians of those in degrees."""
    task.model.eval()
    with torch.no_grad():
        per_batch = [task.scores(batch) for batch in batches]
    scores = {}
    for name in per_batch[0]:
        values = torch.cat([each[name] for each in per_batch]).cpu().numpy()
        scores[name] = float(np.mean(values))
        if name.endswith("_deg"):
            scores[f"median_{name}"] = float(np.median(values))
    return scores


def _validation_batches(config: TrainingConfig, scenes: SceneSource) -> list[Batch]:
    rng = np.random.default_rng([config.seed, VALIDATION_SEED])
    drawn = list(islice(scenes.scenes(rng, config), config.validation_scenes))
    parts = range(0, len(drawn), VALIDATION_BATCH)
    return [collate(config, rng, drawn[part : part + VALIDATION_BATCH]) for part in parts]


def _describe(run: Path, config: TrainingConfig) -> None:
    described = run / "config.json"
    if described.exists():
        held = TrainingConfig.from_dict(json.loads(described.read_text()))
        if held != config:
            raise ValueError(f"{run} holds a run with other settings: name another folder")
    described.write_text(json.dumps(config.as_dict(), indent=2) + "\n")


def _write_curves(
    run: Path, step: int, running: dict[str, float], scores: dict[str, float]
) -> None:
    row: dict[str, Any] = {"step": step, "time": round(time.time())}
    row |= {name: f"{value:.5g}" for name, value in (running | scores).items()}
    path = run / "curves.csv"
    fresh = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if fresh:
            writer.writeheader()
        writer.writerow(row)


class _Tell(Protocol):
    """Listener to a training's state and, now and then, the scores of its validation."""

    def __call__(
        self, fitting: Fitting, loss: float, scores: Mapping[str, float] | None = None
    ) -> None: ...


@contextmanager
def _progress(config: TrainingConfig, first_step: int) -> Iterator[_Tell]:
    """A progress bar, and a line every ``LOG_STEPS`` steps and for every validation."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} loss {task.fields[loss]:.4f}"),
        TimeRemainingColumn(),
    )
    began = time.monotonic()
    with Progress(*columns) as progress:
        bar = progress.add_task(
            config.name, total=config.steps, completed=first_step, loss=math.nan
        )

        def tell(fitting: Fitting, loss: float, scores: Mapping[str, float] | None = None) -> None:
            progress.update(bar, completed=fitting.step, loss=loss)
            if scores is None and fitting.step % LOG_STEPS:
                return
            rate = (fitting.step - first_step) / (time.monotonic() - began)
            line = f"{config.name} step {fitting.step} scenes {config.scenes_in(fitting.step)}"
            line += f" loss {loss:.4f} steps/s {rate:.1f} rate {fitting.learning_rate:.2g}"
            for name, value in (scores or {}).items():
                line += f" {name} {value:.3f}"
            print(line, file=progress.console.file, flush=True)

        yield tell
