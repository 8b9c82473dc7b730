"""Fine-tuning of a bundle on labelled recordings of one room and one array.

For a `weights` bundle the positions of the microphones are calibrated and, if asked for, the whole
network is trained; for a `regression` bundle the encoder and the covariance regressor are trained
(Yang et al. freeze the rest as well). BatchNorm's statistics and the source count are frozen, as
recordings are far too few to estimate them. A new bundle is kept only if the service localizes
held-out directions better with it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import track
from torch import Tensor, nn

from model_export.export.parameters import TrainedModel, trained_model
from model_export.finetuning.array_calibration import ArrayCalibration
from model_export.finetuning.bundle import export_finetuned, fine_tuning_record
from model_export.finetuning.heldout import (
    AS_RECORDED,
    WINDOWS_PER_RECORDING,
    Scores,
    hold_out,
    score,
    score_rows,
)
from model_export.finetuning.labelled_recordings import LabelledRecording
from model_export.finetuning.labelled_scenes import Augmentation, LabelledScenes
from model_export.simulation.room_bank import RoomBank
from model_export.training.regression import RegressionTask
from model_export.training.scene_stream import SceneStream, SimulatedScenes
from model_export.training.task import Batch, Task
from model_export.training.variants import collate
from model_export.training.weights_task import WeightsBatch
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import Bundle, load_bundle
from service.inference.manifest import NAME_PATTERN

ARRAY = "array.json"
"""File of the calibrated array beside a bundle's, for ``--array @FILE`` and for requests"""

LEARNING_RATES = {"weights": 0.0, "regression": 1e-4}
"""Default learning rates of the networks. Calibrating the positions alone cannot forget, and
training the any-array network besides is no sure gain (docs/finetuning.md); the paper's network has
no other way to learn an array."""


@dataclass(frozen=True, slots=True)
class FineTuning:
    """Settings of a fine-tuning."""

    steps: int = 100
    batch_size: int = 16
    """Scenes per step"""
    learning_rate: float | None = None
    """Initial learning rate of the network, with a cosine schedule to zero; 0 freezes the network,
    None takes the variant's in ``LEARNING_RATES``"""
    calibration_rate: float = 2e-4
    """Learning rate of the microphones' positions, about metres per step"""
    validation_share: float = 0.2
    """Share of the directions that are held out"""
    simulated: float = 0.25
    """Share of the steps on simulated rooms, if a room bank is given"""
    augmentation: Augmentation = field(default_factory=Augmentation)
    seed: int = 1

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch_size < 1:
            raise ValueError("steps and batch_size must be positive")
        if not 0 < self.validation_share <= 0.5:
            raise ValueError("the validation share must be above 0 and at most 0.5")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of fine-tuning."""

    array: MicrophoneArray
    """Array, calibrated if the variant works on any array"""
    before: Scores
    after: Scores

    @property
    def better(self) -> bool:
        """Whether fine-tuning made the error on held-out windows, as recorded, smaller."""
        return self.after[AS_RECORDED]["maae_deg"] < self.before[AS_RECORDED]["maae_deg"]


def finetune(
    bundle: Bundle,
    recordings: Sequence[LabelledRecording],
    array: MicrophoneArray,
    out: Path,
    settings: FineTuning,
    *,
    name: str | None = None,
    bank: RoomBank | None = None,
    speech: Sequence[FloatArray] = (),
    test: Sequence[LabelledRecording] = (),
) -> Outcome:
    """Fine-tune a bundle and write the result to ``out``, better or not.

    Beside a `weights` bundle stands the calibrated array, ``array.json``, which scores it.

    Parameters
    ----------
    name : str, optional
        Name of the new bundle; by default the old one's with ``-finetuned``.
        bank : RoomBank, optional
            Simulated rooms for scenes of ``speech``, which keep the network from forgetting rooms.
        test : sequence of LabelledRecording
            Further recordings, for scores only.

    Raises
    ------
    ValueError
        If the bundle cannot be fine-tuned, the name is invalid, or the recordings have too few
        directions.
    """
    name = name or f"{bundle.manifest.name.removesuffix('-finetuned')}-finetuned"
    if not re.fullmatch(NAME_PATTERN, name):
        raise ValueError(f"{name!r} cannot name a bundle: use a-z, 0-9, '.', '_' and '-'")
    if not bundle.fits(array):
        raise ValueError(f"the bundle {bundle.manifest.name} is bound to another array")
    model = trained_model(bundle)
    settings = replace(settings, learning_rate=learning_rate(model, settings))
    if bank is not None and settings.learning_rate == 0:
        raise ValueError("simulated rooms only guard a network in training: give --learning-rate")
    tuned, held_out = hold_out(recordings, settings.validation_share)
    rows = score_rows(LabelledScenes(held_out, array), settings.seed)
    if test:
        rows["test recordings"] = LabelledScenes(test, array).windows(WINDOWS_PER_RECORDING)
    before = score(bundle, array, rows)
    simulated = None
    if bank is not None:
        config = replace(model.config, seed=settings.seed)
        simulated = iter(SceneStream(config, SimulatedScenes(bank, speech)))
    _, calibrated = train(model, LabelledScenes(tuned, array), array, settings, simulated)
    record = fine_tuning_record(tuned, calibrated, asdict(settings), simulated=bank is not None)
    export_finetuned(model, bundle.manifest, out, name, record)
    if calibrated is not array:
        described = {"name": calibrated.name, "positions_m": calibrated.positions.tolist()}
        (out / ARRAY).write_text(json.dumps(described, indent=2) + "\n")
    return Outcome(calibrated, before, score(load_bundle(out), calibrated, rows))


def train(
    model: TrainedModel,
    scenes: LabelledScenes,
    array: MicrophoneArray,
    settings: FineTuning,
    simulated: Iterator[Batch] | None = None,
) -> tuple[list[float], MicrophoneArray]:
    """Train the model in place; the same settings and scenes give the same model.

    Returns
    -------
    losses : list of float
        Loss of every step.
        array : MicrophoneArray
            Calibrated array; for the `regression` variant, whose network learns it, the given one.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng([settings.seed, 2])
    rate = learning_rate(model, settings)
    parameters = trained_parameters(model.task, rate)
    groups: list[dict[str, Any]] = [{"params": parameters, "lr": rate}] if rate else []
    calibration = ArrayCalibration(array) if model.config.variant == "weights" else None
    if calibration is not None:
        place = {"params": [calibration.offsets], "lr": settings.calibration_rate}
        groups.append({**place, "weight_decay": 0.0})
    optimizer = torch.optim.AdamW(groups)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.steps)
    losses = []
    with frozen_statistics(model.task.model):
        for _ in track(range(settings.steps), description="fine-tuning"):
            recorded = rng.random() >= settings.simulated
            if simulated is None or recorded:
                batch = _batch(rng, model, scenes, settings)
                if calibration is not None:
                    assert isinstance(batch, WeightsBatch)
                    delays = calibration.delays(batch.grid).expand(settings.batch_size, -1, -1)
                    batch = replace(batch, delays=delays)
            else:
                batch = next(simulated)
            loss = _finite_loss(model.task, batch)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            torch.nn.utils.clip_grad_norm_(parameters, 1.0)
            optimizer.step()
            schedule.step()
            losses.append(float(loss.detach()))
    return losses, array if calibration is None else calibration.array()


def _finite_loss(task: Task[Any], batch: Batch) -> Tensor:
    diverged = "the training diverged: take a smaller --learning-rate"
    try:
        loss = task.losses(batch)["loss"]
    except RuntimeError as error:  # torch's LinAlgError: covariances of NaN have no eigenvectors
        raise ValueError(diverged) from error
    if not torch.isfinite(loss):
        raise ValueError(diverged)
    return loss


def learning_rate(model: TrainedModel, settings: FineTuning) -> float:
    """The network's learning rate: the one that was set, or its variant's."""
    if settings.learning_rate is None:
        return LEARNING_RATES[model.config.variant]
    return settings.learning_rate


def trained_parameters(task: Task[Any], rate: float) -> list[nn.Parameter]:
    """The network's parameters that fine-tuning trains; all others are frozen.

    A rate of 0 freezes the whole network, which spares the larger part of every step.
    """
    task.model.requires_grad_(False)
    if not rate:
        return []
    part = task.model.covariance if isinstance(task, RegressionTask) else task.model
    part.requires_grad_(True)
    return list(part.parameters())


@contextmanager
def frozen_statistics(model: nn.Module) -> Iterator[None]:
    """Training mode with frozen BatchNorm statistics; evaluation mode afterwards."""
    model.train()
    for module in model.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eval()
    try:
        yield
    finally:
        model.eval()


def _batch(
    rng: np.random.Generator, model: TrainedModel, scenes: LabelledScenes, settings: FineTuning
) -> Batch:
    drawn = [
        scenes.draw(rng, settings.augmentation, model.config.scenes)
        for _ in range(settings.batch_size)
    ]
    return collate(model.config, rng, drawn)
