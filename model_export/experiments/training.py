"""One network's training on a scene set, resumable, and its self-supervised stage."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

from model_export.baselines.network import BaselineNetwork, Truth
from model_export.experiments.augmentation import sometimes_noisy
from model_export.experiments.scene_set import SceneSet
from model_export.simulation.scenes import Scene
from model_export.simulation.symmetry import Symmetry, symmetries
from model_export.training.config import PAPER_SSCL
from model_export.training.fitting import Fitting, checkpoint
from model_export.training.sscl import SsclTask, collate_masked
from service.doa.types import FloatArray

Track = Literal["cited", "matched"]
"""Track: as published with its own features, or with our input, targets and count branch"""

SSCL = replace(PAPER_SSCL, smooth_kernels=0, pool_first=False, level_exponent=0.0)
"""The self-supervised stage on the features and the plain parameters of the matched track"""
TUNING_RATE = 0.3
"""Factor of the learning rate in fine-tuning, which is to keep the first training's result"""
CHECKPOINT_STEPS = 50


@dataclass(frozen=True, slots=True)
class Training:
    """A network and its training data; equal trainings are done once."""

    method: str
    track: Track = "matched"
    scenes: str = "train"
    """Name of the scene set"""
    share: float = 1.0
    """Share of the scene set, drawn at random"""
    pretrained: bool = False
    """Whether the encoder comes from self-supervised learning on the whole scene set"""
    attention: bool = True
    """Whether frequencies are weighted (FAF) or count alike"""
    tuned_to: str | None = None
    """Name of the scene set of a fine-tuning after the training"""

    @property
    def key(self) -> str:
        """A name for files."""
        parts = [self.method, self.track, self.scenes, f"{100 * self.share:g}"]
        parts += ["sscl"] if self.pretrained else []
        parts += [] if self.attention else ["mean"]
        parts += [f"to-{self.tuned_to}"] if self.tuned_to else []
        return "-".join(parts)


@dataclass(frozen=True, slots=True)
class Budget:
    """Length and learning rate of a training."""

    epochs: int
    batch_size: int
    rate: float = 1.0
    """Factor of the network's own learning rate"""


Progress = Callable[[int, int, float], None]
"""Called with the step, the number of steps and the running loss"""


def fit(
    network: BaselineNetwork,
    scenes: SceneSet,
    budget: Budget,
    run: Path,
    seed: int,
    progress: Progress,
    device: str = "cpu",
) -> BaselineNetwork:
    """Train on a scene set, from the run's checkpoint if there is one.

    Every batch depends only on the seed and the step, so an interrupted training ends like a whole
    one, except for the optimizer's rounding.
    """
    per_epoch = max(1, len(scenes) // budget.batch_size)
    steps = budget.epochs * per_epoch
    network.to(device)
    fitting = _Curve(network, network.learning_rate * budget.rate, steps, run)
    views = symmetries(scenes.array)
    network.train()
    while fitting.step < steps:
        epoch, place = divmod(fitting.step, per_epoch)
        order = np.random.default_rng([seed, epoch]).permutation(len(scenes))
        chosen = order[place * budget.batch_size : (place + 1) * budget.batch_size]
        rng = np.random.default_rng([seed, 1, fitting.step])
        audio, truth = _batch(rng, scenes, chosen, views)
        array = scenes.array
        if network.steered:
            turn = float(rng.uniform(0, 2 * np.pi))
            array, truth = array.rotated(turn), replace(truth, azimuth=truth.azimuth + turn)
        truth = truth.to(device)
        features = torch.from_numpy(network.features(audio)).to(device)
        prediction = network(features, array, truth.count)
        fitting.optimize(network.loss(prediction, truth, array))
        progress(fitting.step, steps, fitting.running)
    return network.cpu().eval()


def pretrain(
    scenes: SceneSet, budget: Budget, run: Path, seed: int, progress: Progress, device: str = "cpu"
) -> None:
    """Run the self-supervised stage on a scene set without labels; the run keeps a checkpoint."""
    task = SsclTask(SSCL, scenes.array)
    task.model.to(device).train()
    size = min(budget.batch_size, len(scenes))
    steps = budget.epochs * max(1, len(scenes) // size)
    fitting = _Curve(task.model, SSCL.learning_rate * budget.rate, steps, run)
    while fitting.step < steps:
        rng = np.random.default_rng([seed, 2, fitting.step])
        chosen = np.sort(rng.choice(len(scenes), size, replace=False))
        batch = collate_masked(rng, [_unlabelled(scenes, int(index)) for index in chosen])
        fitting.optimize(task.losses(batch.to(device))["loss"])
        progress(fitting.step, steps, fitting.running)


def parameters(run: Path) -> dict[str, torch.Tensor]:
    """The model of a run's checkpoint, on the CPU."""
    model: dict[str, torch.Tensor] = checkpoint(run)["model"]
    return model


class _Curve:
    """A run's fitting and its running loss, saved with every checkpoint."""

    def __init__(self, model: nn.Module, rate: float, steps: int, run: Path) -> None:
        run.mkdir(parents=True, exist_ok=True)
        self._path, self._steps = run / "curve.json", steps
        warm_up = max(1, min(100, steps // 10))
        optimizer = torch.optim.Adam(model.parameters(), rate)
        self._fitting = Fitting(model, optimizer, steps, warm_up, run)
        points = json.loads(self._path.read_text()) if self.step else []
        self._points = [point for point in points if point["step"] <= self.step]
        self.running = self._points[-1]["loss"] if self._points else math.nan

    @property
    def step(self) -> int:
        return self._fitting.step

    def optimize(self, loss: torch.Tensor) -> None:
        """One step; a checkpoint every ``CHECKPOINT_STEPS`` and at the end."""
        self._fitting.optimize(loss)
        value = float(loss.detach())
        self.running = value if math.isnan(self.running) else 0.95 * self.running + 0.05 * value
        if self.step % CHECKPOINT_STEPS == 0 or self.step == self._steps:
            self._points.append({"step": self.step, "loss": self.running})
            # The curve is saved first: a checkpoint without its point could not be continued.
            self._path.write_text(json.dumps(self._points) + "\n")
            self._fitting.save()


def describe(run: Path, training: Training, budget: Budget) -> None:
    """Write a run's description, ``training.json``.

    Raises
    ------
    ValueError
        If the folder holds a run of another training or budget.
    """
    described = {**asdict(training), **asdict(budget)}
    path = run / "training.json"
    if not path.exists():
        run.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(described, indent=2) + "\n")
    elif json.loads(path.read_text()) != described:
        raise ValueError(f"{run} holds another training: remove it or name another --runs folder")


def _batch(
    rng: np.random.Generator,
    scenes: SceneSet,
    chosen: np.ndarray[Any, Any],
    views: list[Symmetry],
) -> tuple[FloatArray, Truth]:
    """Noisy windows (B, N, T), each under a random symmetry of the array, and the truth."""
    audio = scenes.audio[np.sort(chosen)].astype(np.float32)
    azimuth = scenes.azimuth[np.sort(chosen)].astype(np.float32).copy()
    for index in range(len(audio)):
        view = views[int(rng.integers(len(views)))]
        audio[index] = audio[index][view.permutation]
        azimuth[index] = view.azimuth(azimuth[index])
    mask = np.isfinite(azimuth)
    truth = Truth(torch.from_numpy(np.where(mask, azimuth, 0)), torch.from_numpy(mask))
    return sometimes_noisy(rng, audio), truth


def _unlabelled(scenes: SceneSet, index: int) -> Scene:
    return Scene(scenes.window(index), scenes.array.positions, np.empty(0))
