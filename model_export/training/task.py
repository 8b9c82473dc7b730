"""What a variant must offer to be trained: a model, batches from scenes, losses and scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import TrainingConfig
from model_export.training.subspace import delay_products
from model_export.training.targets import spectrum_cross_entropy, target_spectrum
from model_export.training.weights import FusedSpectrum, WeightsPipeline
from service.doa.array import SPEED_OF_SOUND
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.steering import resolution, unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.results import MAX_SOURCES

Batch = dict[str, Tensor]
STFT = Stft()
BIN_STEP = 2
"""Every other bin, from a random one on, forms spectra in training"""
SHORT_SAMPLES = STFT.num_samples(32)
"""Half a second: what a stream's first results and short windows have"""
SHARE_WEIGHT = 2.0
"""Weight of the direct sound's share against the spectra's cross entropy"""


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
    if config.distils:
        from model_export.training.distil import DistilTask  # it builds on this module

        return DistilTask(config)
    if config.variant == "weights":
        return WeightsTask(config)
    if config.variant == "sscl":
        from model_export.training.sscl import SsclTask  # it builds on this module

        return SsclTask(config)
    from model_export.training.regression import RegressionTask  # this one, too

    return RegressionTask(config)


class WeightsTask:
    """Any array, any room: cross entropy on the fused spectrum."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.model = WeightsPipeline(config.trunk)

    def start_from(self, start: Task) -> None:
        self.model.load_state_dict(start.model.state_dict())

    def collate(self, rng: np.random.Generator, scenes: Sequence[Scene]) -> Batch:
        scenes = self.cut(rng, scenes)
        spectra = STFT.transform(np.stack([scene.audio for scene in scenes]))[:, :, 1:]
        bins = np.arange(rng.integers(BIN_STEP), spectra.shape[2], BIN_STEP)
        offset = rng.uniform(0, 2 * np.pi / self.config.grid_size)
        grid = offset + np.arange(self.config.grid_size) * (2 * np.pi / self.config.grid_size)
        positions = np.stack([scene.positions for scene in scenes])
        shares = np.stack([direct_share(scene) for scene in scenes])
        resolutions = [resolution(array, STFT.frequencies[1:]) for array in positions]
        return {
            "features": torch.from_numpy(coherence_features(*unit_vectors_and_power(spectra))),
            "spectra": torch.from_numpy(np.ascontiguousarray(spectra[:, :, bins])),
            "bins": torch.from_numpy(bins),
            "delays": torch.from_numpy(steering_delays(positions, grid)),
            "resolution": torch.tensor(resolutions),
            "grid": torch.from_numpy(grid.astype(np.float32)),
            "direct_share": torch.from_numpy(shares),
            **padded_azimuths(scenes),
        }

    def cut(self, rng: np.random.Generator, scenes: Sequence[Scene]) -> Sequence[Scene]:
        """The scenes, now and then half a second of them."""
        if rng.random() >= self.config.short_windows:
            return scenes
        start = int(rng.integers(WINDOW_SAMPLES - SHORT_SAMPLES))
        return [scene.crop(start, SHORT_SAMPLES) for scene in scenes]

    def losses(self, batch: Batch) -> dict[str, Tensor]:
        result = self._run(batch)
        sigma = float(np.deg2rad(self.config.target_sigma_deg))
        target = target_spectrum(batch["azimuth"], batch["mask"], batch["grid"], sigma)
        losses = {
            "spectrum": spectrum_cross_entropy(result.fused, target, result.sharpness),
            "share": known_cross_entropy(result.direct_share, batch["direct_share"]),
        }
        return {"loss": losses["spectrum"] + SHARE_WEIGHT * losses["share"], **losses}

    def scores(self, batch: Batch) -> dict[str, float]:
        return {"peak_error_deg": nearest_peak_error(self._run(batch).fused, batch)}

    def _run(self, batch: Batch) -> FusedSpectrum:
        frequencies = torch.from_numpy(STFT.frequencies[1:]).float().to(batch["bins"].device)
        result: FusedSpectrum = self.model(
            batch["features"],
            batch["spectra"],
            delay_products(batch["delays"], frequencies[batch["bins"]]),
            resolution=batch["resolution"],
            bins=batch["bins"],
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

    At the first microphone, |D|^2 / (|D|^2 + |X - D|^2) of the talker that is strongest there; 0
    without talkers. It is what the weights should follow; NaN in recordings, where nobody knows.
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
