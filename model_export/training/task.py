"""What a variant must offer to be trained, and what the variants share.

Scenes become a batch in the processes that simulate them, by the variant's ``collate``, which
builds no network; a ``Task`` owns the model that learns from the batches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from model_export.simulation.scenes import Scene
from service.doa.array import SPEED_OF_SOUND
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.results import MAX_SOURCES

STFT = Stft()
SHORT_SAMPLES = STFT.num_samples(32)
"""Half a second: what a stream's first results and short windows have"""


@dataclass(frozen=True)
class Batch:
    """Tensors that one step learns from; B is the number of scenes."""

    def to(self, device: str) -> Self:
        """The same on a device; scenes are simulated on the CPU whatever trains on them."""
        tensors = ((each.name, getattr(self, each.name)) for each in fields(self))
        return type(self)(**{name: each.to(device, non_blocking=True) for name, each in tensors})


@dataclass(frozen=True)
class LocatedBatch(Batch):
    """A batch with the directions of its sources."""

    azimuth: Tensor
    """(B, 4) radians"""
    mask: Tensor
    """(B, 4) bool, which azimuths are sources"""
    grid: Tensor
    """(A,) float32 radians, the angles that spectra are computed at"""


BatchT = TypeVar("BatchT", bound=Batch, contravariant=True)


class Task(Protocol[BatchT]):
    """One variant under training."""

    @property
    def model(self) -> nn.Module: ...

    def start_from(self, start: Task[Any]) -> None:
        """Take what an earlier stage has learned, or say why it does not fit (ValueError)."""

    def losses(self, batch: BatchT) -> dict[str, Tensor]: ...

    def scores(self, batch: BatchT) -> dict[str, Tensor]:
        """One number a scene, or one a batch, by name; those in degrees end in ``_deg``."""


def steering_delays(positions: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Advances (B, N, A) float32 in seconds of plane waves at microphones (B, N, 3)."""
    centred = positions - positions.mean(axis=-2, keepdims=True)
    delays: FloatArray = centred @ unit_vectors(azimuth).T / SPEED_OF_SOUND
    return delays.astype(np.float32)


def padded_azimuths(scenes: Sequence[Scene]) -> tuple[Tensor, Tensor]:
    """``LocatedBatch.azimuth`` and ``mask``."""
    azimuth = torch.zeros(len(scenes), MAX_SOURCES)
    mask = torch.zeros(len(scenes), MAX_SOURCES, dtype=torch.bool)
    for index, scene in enumerate(scenes):
        count = len(scene.azimuth)
        azimuth[index, :count] = torch.from_numpy(np.asarray(scene.azimuth, dtype=np.float32))
        mask[index, :count] = True
    return azimuth, mask


def nearest_peak_error(fused: Tensor, batch: LocatedBatch) -> Tensor:
    """Degrees from the highest peak to the nearest source, one for every scene that has any."""
    best = batch.grid[fused.argmax(-1)]
    gaps = torch.remainder(batch.azimuth - best[:, None] + torch.pi, 2 * torch.pi) - torch.pi
    errors = gaps.abs().masked_fill(~batch.mask, torch.inf).amin(-1)
    return torch.rad2deg(errors[torch.isfinite(errors)])
