"""What a variant must offer to be trained: a model, batches from scenes, losses and scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from model_export.config import TrainingConfig
from model_export.scenes import Scene
from model_export.subspace import delay_products
from model_export.targets import spectrum_cross_entropy, target_spectrum
from model_export.weights import FusedSpectrum, WeightsPipeline
from service.doa.array import SPEED_OF_SOUND
from service.doa.features import coherence_features
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray

Batch = dict[str, Tensor]
MAX_SOURCES = 4
STFT = Stft()


class Task(Protocol):
    """One variant under training."""

    @property
    def model(self) -> nn.Module: ...

    def start_from(self, start: Task) -> None:
        """Take what an earlier stage has learned, or say why it does not fit (ValueError)."""

    def collate(self, rng: np.random.Generator, scenes: Sequence[Scene]) -> Batch: ...

    def losses(self, batch: Batch) -> dict[str, Tensor]: ...

    def scores(self, batch: Batch) -> dict[str, float]: ...


def task_of(config: TrainingConfig) -> Task:
    """The task of a configuration, with a freshly initialised model."""
    if config.variant == "weights":
        return WeightsTask(config)
    if config.variant == "sscl":
        from model_export.sscl import SsclTask  # it builds on this module

        return SsclTask(config)
    from model_export.regression import RegressionTask  # this one, too

    return RegressionTask(config)


class WeightsTask:
    """Any array, any room: cross entropy on the fused spectrum."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.model = WeightsPipeline()

    def start_from(self, start: Task) -> None:
        self.model.load_state_dict(start.model.state_dict())

    def collate(self, rng: np.random.Generator, scenes: Sequence[Scene]) -> Batch:
        spectra = STFT.transform(np.stack([scene.audio for scene in scenes]))[:, :, 1:]
        offset = rng.uniform(0, 2 * np.pi / self.config.grid_size)
        grid = offset + np.arange(self.config.grid_size) * (2 * np.pi / self.config.grid_size)
        delays = steering_delays(np.stack([scene.positions for scene in scenes]), grid)
        return {
            "features": torch.from_numpy(coherence_features(spectra)),
            "spectra": torch.from_numpy(spectra),
            "delays": torch.from_numpy(delays),
            "grid": torch.from_numpy(grid.astype(np.float32)),
            **padded_azimuths(scenes),
        }

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        result = self._run(batch)
        sigma = float(np.deg2rad(self.config.target_sigma_deg))
        target = target_spectrum(batch["azimuth"], batch["mask"], batch["grid"], sigma)
        return {"loss": spectrum_cross_entropy(result.fused, target, result.sharpness)}

    def scores(self, batch: Batch) -> dict[str, float]:
        return {"peak_error_deg": nearest_peak_error(self._run(batch).fused, batch)}

    def _run(self, batch: Batch) -> FusedSpectrum:
        products = delay_products(batch["delays"], torch.from_numpy(STFT.frequencies[1:]).float())
        result: FusedSpectrum = self.model(batch["features"], batch["spectra"], products)
        return result


def steering_delays(positions: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Advances (B, N, A) float32 in seconds of plane waves at microphones (B, N, 3)."""
    centred = positions - positions.mean(axis=-2, keepdims=True)
    delays: FloatArray = centred @ unit_vectors(azimuth).T / SPEED_OF_SOUND
    return delays.astype(np.float32)


def padded_azimuths(scenes: Sequence[Scene]) -> Batch:
    """``azimuth`` (B, 4) radians and ``mask`` (B, 4) of which entries are sources."""
    azimuth = torch.zeros(len(scenes), MAX_SOURCES)
    mask = torch.zeros(len(scenes), MAX_SOURCES, dtype=torch.bool)
    for index, scene in enumerate(scenes):
        count = len(scene.azimuth)
        azimuth[index, :count] = torch.from_numpy(np.asarray(scene.azimuth, dtype=np.float32))
        mask[index, :count] = True
    return {"azimuth": azimuth, "mask": mask}


def nearest_peak_error(fused: Tensor, batch: Batch) -> float:
    """Median distance in degrees from the highest peak to the nearest source."""
    best = batch["grid"][fused.argmax(-1)]
    gaps = torch.remainder(batch["azimuth"] - best[:, None] + torch.pi, 2 * torch.pi) - torch.pi
    errors = gaps.abs().masked_fill(~batch["mask"], torch.inf).amin(-1)
    finite = errors[torch.isfinite(errors)]
    return float(torch.rad2deg(finite.median())) if len(finite) else 0.0
