"""The `weights` variant under training: cross entropy on the fused spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import TrainingConfig
from model_export.training.subspace import delay_products
from model_export.training.targets import spectrum_cross_entropy, target_spectrum
from model_export.training.task import (
    SHORT_SAMPLES,
    STFT,
    Batch,
    LocatedBatch,
    Task,
    nearest_peak_error,
    padded_azimuths,
    steering_delays,
)
from model_export.training.weights import FusedSpectrum, WeightsPipeline
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.steering import resolution
from service.doa.types import ComplexArray, FloatArray

BIN_STEP = 2
"""Step between the bins whose spectra are computed in training; the first is random"""
SHARE_WEIGHT = 2.0
"""Weight of the direct sound's share against the spectra's cross entropy"""


@dataclass(frozen=True)
class CellBatch(Batch):
    """The network's features and the truth of every cell; F = 256 bins, L frames."""

    features: Tensor
    """(B, 5, F, L) float32 array-independent features"""
    direct_share: Tensor
    """(B, F, L) float32 share of the strongest direct sound in [0, 1], NaN where unknown"""


@dataclass(frozen=True)
class WeightsBatch(CellBatch, LocatedBatch):
    """A batch with the inputs of spectra, in a part F' of the bins."""

    spectra: Tensor
    """(B, N, F', L) complex64"""
    bins: Tensor
    """(F',) int64, the bins of the spectra among those of the features"""
    delays: Tensor
    """(B, N, A) float32 seconds, steering delays of the grid"""
    resolution: Tensor
    """(B,) resolutions of the arrays, from ``service.doa.steering.resolution``"""


def collate_cells(
    config: TrainingConfig, rng: np.random.Generator, scenes: Sequence[Scene]
) -> CellBatch:
    """Features of scenes, or sometimes of half a second of them, without directions."""
    return CellBatch(*_cells(_cut(config, rng, scenes))[:2])


def collate_weights(
    config: TrainingConfig, rng: np.random.Generator, scenes: Sequence[Scene]
) -> WeightsBatch:
    """Batch of scenes, or sometimes of half a second of them; grid and bins start at random."""
    scenes = _cut(config, rng, scenes)
    features, shares, spectra = _cells(scenes)
    bins = np.arange(rng.integers(BIN_STEP), spectra.shape[2], BIN_STEP)
    offset = rng.uniform(0, 2 * np.pi / config.grid_size)
    grid = offset + np.arange(config.grid_size) * (2 * np.pi / config.grid_size)
    positions = np.stack([scene.positions for scene in scenes])
    azimuth, mask = padded_azimuths(scenes)
    return WeightsBatch(
        azimuth=azimuth,
        mask=mask,
        grid=torch.from_numpy(grid.astype(np.float32)),
        features=features,
        direct_share=shares,
        spectra=torch.from_numpy(np.ascontiguousarray(spectra[:, :, bins])),
        bins=torch.from_numpy(bins),
        delays=torch.from_numpy(steering_delays(positions, grid)),
        resolution=torch.tensor([resolution(each, STFT.frequencies[1:]) for each in positions]),
    )


def _cells(scenes: Sequence[Scene]) -> tuple[Tensor, Tensor, ComplexArray]:
    """Features and direct shares of a ``CellBatch``, and the spectra (B, N, F, L)."""
    spectra = STFT.transform(np.stack([scene.audio for scene in scenes]))[:, :, 1:]
    features = torch.from_numpy(coherence_features(*unit_vectors_and_power(spectra)))
    shares = torch.from_numpy(np.stack([direct_share(scene) for scene in scenes]))
    return features, shares, spectra


def _cut(
    config: TrainingConfig, rng: np.random.Generator, scenes: Sequence[Scene]
) -> Sequence[Scene]:
    if rng.random() >= config.short_windows:
        return scenes
    start = int(rng.integers(WINDOW_SAMPLES - SHORT_SAMPLES))
    return [scene.crop(start, SHORT_SAMPLES) for scene in scenes]


class WeightsTask:
    """Any array, any room: cross entropy on the fused spectrum."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.model = WeightsPipeline(config.trunk)

    def start_from(self, start: Task[Any]) -> None:
        self.model.load_state_dict(start.model.state_dict())

    def losses(self, batch: WeightsBatch) -> dict[str, Tensor]:
        result = self._run(batch)
        sigma = float(np.deg2rad(self.config.target_sigma_deg))
        target = target_spectrum(batch.azimuth, batch.mask, batch.grid, sigma)
        losses = {
            "spectrum": spectrum_cross_entropy(result.fused, target, result.sharpness),
            "share": known_cross_entropy(result.direct_share, batch.direct_share),
        }
        return {"loss": losses["spectrum"] + SHARE_WEIGHT * losses["share"], **losses}

    def scores(self, batch: WeightsBatch) -> dict[str, Tensor]:
        return {"peak_error_deg": nearest_peak_error(self._run(batch).fused, batch)}

    def _run(self, batch: WeightsBatch) -> FusedSpectrum:
        frequencies = torch.from_numpy(STFT.frequencies[1:]).float().to(batch.bins.device)
        result: FusedSpectrum = self.model(
            batch.features,
            batch.spectra,
            delay_products(batch.delays, frequencies[batch.bins]),
            resolution=batch.resolution,
            bins=batch.bins,
        )
        return result


def known_cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    """Mean binary cross entropy over the cells whose target is not NaN."""
    known = torch.isfinite(target)
    if not known.any():
        return logits.sum() * 0.0
    return F.binary_cross_entropy_with_logits(logits[known], target[known])


def direct_share(scene: Scene) -> FloatArray:
    """Share of the strongest talker's direct sound in every cell, (F, L) float32 in [0, 1].

    The share is |D|^2 / (|D|^2 + |X - D|^2) at the first microphone, of the talker that is
    strongest in the cell; 0 without talkers, and NaN in recordings, where it is unknown. The
    weights should follow it.
    """
    if scene.direct is None or scene.heard is None:
        shape = (STFT.num_bins - 1, STFT.num_frames(scene.audio.shape[-1]))
        return np.full(shape, np.nan, dtype=np.float32)
    heard = STFT.transform(scene.heard)[1:]
    if not len(scene.direct):
        return np.zeros(heard.shape, dtype=np.float32)
    direct = STFT.transform(scene.direct)[:, 1:]
    powers = direct.real**2 + direct.imag**2  # (M, F, L)
    strongest = powers.argmax(axis=0)[None]
    rest = heard - np.take_along_axis(direct, strongest, axis=0)[0]
    power = np.take_along_axis(powers, strongest, axis=0)[0]
    share: FloatArray = power / (power + rest.real**2 + rest.imag**2 + np.float32(1e-12))
    return share.astype(np.float32)
