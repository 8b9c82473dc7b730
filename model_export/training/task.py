"""The interface of a variant under training, and functions that variants share.

The processes that simulate scenes also make batches of them, with the variant's ``collate``, which
builds no network. A ``Task`` owns the model that learns from the batches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from model_export.simulation.scenes import Scene
from model_export.training.config import TrainingConfig
from service.doa.array import SPEED_OF_SOUND
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.results import MAX_SOURCES

STFT = Stft()
SHORT_SAMPLES = STFT.num_samples(32)
"""Half a second, the length of short windows and of a stream's first results"""


@dataclass(frozen=True)
class Batch:
    """Tensors of one training step; B is the number of scenes."""

    def to(self, device: str) -> Self:
        """Copy the batch to a device; scenes are always simulated on the CPU."""
        tensors = ((each.name, getattr(self, each.name)) for each in fields(self))
        return type(self)(**{name: each.to(device, non_blocking=True) for name, each in tensors})


@dataclass(frozen=True)
class LocatedBatch(Batch):
    """A batch with the directions of its sources."""

    azimuth: Tensor
    """(B, 4) radians"""
    mask: Tensor
    """(B, 4) bool, True where the azimuth is a source's"""
    grid: Tensor
    """(A,) float32 radians, the angles of the spectra"""


BatchT = TypeVar("BatchT", bound=Batch, contravariant=True)


class Task(Protocol[BatchT]):
    """One variant under training."""

    config: TrainingConfig

    @property
    def model(self) -> nn.Module: ...

    def start_from(self, start: Task[Any]) -> None:
        """Load what an earlier stage has learned; ValueError says why it does not fit."""

    def losses(self, batch: BatchT) -> dict[str, Tensor]: ...

    def scores(self, batch: BatchT) -> dict[str, Tensor]:
        """One number a scene, or one a batch, by name; those in degrees end in ``_deg``."""


def steering_delays(positions: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Advances (B, N, A) float32 in seconds of plane waves from azimuths (A,) in radians.

    ``positions`` are the microphones (B, N, 3) in metres.
    """
    centred = positions - positions.mean(axis=-2, keepdims=True)
    delays: FloatArray = centred @ unit_vectors(azimuth).T / SPEED_OF_SOUND
    return delays.astype(np.float32)


def padded_azimuths(scenes: Sequence[Scene]) -> tuple[Tensor, Tensor]:
    """The fields ``azimuth`` and ``mask`` of a ``LocatedBatch``."""
    azimuth = torch.zeros(len(scenes), MAX_SOURCES)
    mask = torch.zeros(len(scenes), MAX_SOURCES, dtype=torch.bool)
    for index, scene in enumerate(scenes):
        count = len(scene.azimuth)
        azimuth[index, :count] = torch.from_numpy(np.asarray(scene.azimuth, dtype=np.float32))
        mask[index, :count] = True
    return azimuth, mask


def nearest_peak_error(fused: Tensor, batch: LocatedBatch) -> Tensor:
    """Degrees from the highest peak of (B, A) to the nearest source, for every scene with any."""
    best = batch.grid[fused.argmax(-1)]
    gaps = torch.remainder(batch.azimuth - best[:, None] + torch.pi, 2 * torch.pi) - torch.pi
    errors = gaps.abs().masked_fill(~batch.mask, torch.inf).amin(-1)
    return torch.rad2deg(errors[torch.isfinite(errors)])
