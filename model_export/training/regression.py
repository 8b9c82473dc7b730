"""The `regression` variant: the paper's pipeline, covariances out of the network, one array.

Features -> CovarianceNetwork -> EVD -> signal projector -> MUSIC -> FAF, and SourceCountNetwork
beside it. Deviations from the paper's text:

- Phases are relative to microphone 0 (``service.doa.spectrogram``), and the loss has a third term,
  ``subspace_distance``. Without either a network stays at chance for thousands of scenes: absolute
  phases hide delays, and the spectrum's squared error alone first teaches the bins to disagree,
  which lowers the fused background.
- The MUSIC floor is learned and spectra are divided by their maximum per bin, because the paper's
  unbounded P spans six decades; FAF divides by the sum of its weights.
- Scenes without a source train the count branch only, MUSIC having no spectrum for them.

The encoder comes from the self-supervised stage (``model_export.training.sscl``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.simulation.scenes import Scene
from model_export.training.config import TrainingConfig
from model_export.training.networks.fusion import FrequencyAttentionFusion
from model_export.training.networks.regressor import CovarianceNetwork
from model_export.training.networks.source_count import SourceCountNetwork
from model_export.training.precision import training_precision
from model_export.training.reparametrize import load_plain, reparametrize
from model_export.training.sscl import SsclTask, load_encoder
from model_export.training.subspace import delay_products, signal_power, signal_projector
from model_export.training.targets import target_spectrum
from model_export.training.task import (
    STFT,
    LocatedBatch,
    Task,
    padded_azimuths,
    steering_delays,
)
from service.doa.array import MicrophoneArray
from service.doa.peaks import find_peaks
from service.doa.presets import preset
from service.doa.scoring import maae
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray

SCORED_GRID = 360
"""Azimuths of the spectra that development scenes are scored by, as in a bundle"""


@dataclass(frozen=True, slots=True)
class RegressionResult:
    """Output of the differentiable pipeline."""

    fused: Tensor
    """(B, A) in (0, 1]"""
    logits: Tensor | None
    """(B, 5) of 0 to 4 sources, where they were asked for"""
    projector: Tensor
    """(B, F, N, N) complex, on the signal subspace"""


class RegressionPipeline(nn.Module):
    """The paper's networks with differentiable MUSIC between them."""

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.covariance = CovarianceNetwork(num_microphones)
        self.count = SourceCountNetwork(num_microphones)
        self.fusion = FrequencyAttentionFusion()
        self.log_floor = nn.Parameter(torch.tensor(-3.2))
        """MUSIC's floor, about 0.04: the width of the peaks"""

    def forward(
        self,
        features: Tensor,
        products: Tensor,
        num_sources: Tensor,
        bins: Tensor | None = None,
        *,
        counts: bool = True,
    ) -> RegressionResult:
        """Fused spectra and count logits.

        Parameters
        ----------
        features : (B, 2N, 257, 64) real
        products : (F, N^2, A) real
            The steering vectors' ``delay_products``, of the one array that all scenes share.
        num_sources : (B,) int
            The true counts in training (teacher forcing).
        bins : (F,) int64, optional
            Bins whose spectra are formed; all 257 by default.
        counts : bool
            Whether the count branch runs.
        """
        # What follows needs float32's digits.
        with training_precision(features, training=self.training):
            features = features.contiguous(memory_format=torch.channels_last)
            latent = self.covariance.encoder(features)
            logits = self.count(features).float() if counts else None
        chosen = latent if bins is None else latent[:, bins]
        parts = self.covariance.regressor(chosen.float())  # (B, F, 2, N, N)
        covariance = torch.complex(parts[:, :, 0], parts[:, :, 1])  # (B, F, N, N)
        projector = counted_projector(covariance, num_sources)  # (B, F, N, N)
        # The scenes share a bin's steering vectors, hence bins first.
        power = signal_power(projector.transpose(0, 1), products)  # (F, B, A)
        spectrum = 1 / (1 - power.clamp(max=1) + self.log_floor.exp())  # (F, B, A)
        spectrum = spectrum / spectrum.amax(-1, keepdim=True)
        fused = self.fusion(spectrum.transpose(0, 1), bins)  # (B, A)
        return RegressionResult(fused, logits, projector)


def counted_projector(covariance: Tensor, num_sources: Tensor) -> Tensor:
    """Signal projectors (B, F, N, N) of scenes that differ in their number of sources.

    Counts are held to 1 ... N - 1, for which there are both a signal and a noise subspace.
    """
    counts = num_sources.clamp(1, covariance.shape[-1] - 1)
    groups = [(counts == count).nonzero()[:, 0] for count in counts.unique()]
    projectors = [signal_projector(covariance[group], int(counts[group[0]])) for group in groups]
    return torch.cat(projectors)[torch.cat(groups).argsort()]


def subspace_distance(projector: Tensor, products: Tensor, mask: Tensor) -> Tensor:
    """Distance of the true steering vectors from the signal subspaces, mean over bins and sources.

    It is MUSIC's denominator at the true directions, 1 - a^H Ps a / N, which every bin has to bring
    to zero: the subspace loss of Chen and Rao (arXiv 2408.16605), without the projector on the true
    steering vectors, which is ill-conditioned at low frequencies.

    Parameters
    ----------
    projector : (B, F, N, N) complex
    products : (B, F, N^2, M) real
        ``delay_products`` of the sources' directions.
    mask : (B, M) bool
        Which of them are sources.
    """
    distance = 1 - signal_power(projector[:, :, None], products)[:, :, 0]  # (B, F, M)
    weights = mask[:, None].float()
    return (distance * weights).sum() / (weights.sum() * distance.shape[1]).clamp(min=1)


@dataclass(frozen=True)
class RegressionBatch(LocatedBatch):
    """Scenes of one array, which is turned together with their azimuths."""

    features: Tensor
    """(B, 2N, 257, 64) float32, from ``service.doa.spectrogram``"""
    rotation: Tensor
    """() radians, counter-clockwise"""
    bins: Tensor
    """(F',) int64, those that the losses form spectra of"""


def collate_regression(
    config: TrainingConfig, rng: np.random.Generator, scenes: Sequence[Scene]
) -> RegressionBatch:
    """Features, and the array and the labels turned by one random angle per batch.

    The audio is left alone. No weight behind the regressor belongs to an angle, so the loss of a
    turned batch is that of the unturned one on a grid turned the other way: one angle per batch
    serves as well as one per scene.
    """
    spectra = STFT.transform(np.stack([scene.audio for scene in scenes]))  # (B, N, F, L)
    rotation = float(rng.uniform(0, 2 * np.pi))
    azimuth, mask = padded_azimuths(scenes)
    return RegressionBatch(
        azimuth=azimuth + rotation,
        mask=mask,
        grid=torch.from_numpy(azimuth_grid(config.grid_size).astype(np.float32)),
        features=torch.from_numpy(
            spectrogram_features(spectra, config.phase_reference, config.level_exponent)
        ),
        rotation=torch.tensor(rotation),
        bins=torch.arange(int(rng.integers(config.bin_step)), STFT.num_bins, config.bin_step),
    )


class RegressionTask:
    """One array in low-order rooms: MSE on the fused spectrum, cross entropy on the count.

    ``config.subspace_weight`` scales ``subspace_distance``; 0 leaves the paper's loss.
    """

    def __init__(self, config: TrainingConfig) -> None:
        if config.array is None:
            raise ValueError("the regression variant is bound to one array: name its preset")
        self.config = config
        self.array = preset(config.array)
        self.model = RegressionPipeline(self.array.num_microphones)
        if not config.attention:
            self.model.fusion.average()
        reparametrize(self.model, config)

    def start_from(self, start: Task[Any]) -> None:
        """Take a self-supervised stage's encoder, or all of a run that is trained further.

        Raises
        ------
        ValueError
            If ``start`` was trained on other features, another array or another encoder.
        """
        if isinstance(start, RegressionTask):
            start.config.check_features(self.config)
            load_plain(self.model, start.model.state_dict())
        elif isinstance(start, SsclTask):
            load_encoder(self.model.covariance.encoder, start, self.config)
        else:
            raise ValueError(
                f"{self.config.name} starts from an `sscl` or a `regression` run, not from another "
                "kind"
            )

    def losses(self, batch: RegressionBatch) -> dict[str, Tensor]:
        count = batch.mask.sum(-1)
        products = rotated_products(self.array, batch.rotation, batch.grid[None], batch.bins)[0]
        result = self.model(
            batch.features, products, count, batch.bins, counts=self.config.count_weight > 0
        )
        sigma = float(np.deg2rad(self.config.target_sigma_deg))
        target = target_spectrum(batch.azimuth, batch.mask, batch.grid, sigma)
        error = (result.fused - target).square().mean(-1)  # (B,)
        present = (count > 0).float()
        losses = {
            "spectrum": (present * error).sum() / present.sum().clamp(min=1),
            "subspace": subspace_distance(
                result.projector,
                rotated_products(self.array, batch.rotation, batch.azimuth, batch.bins),
                batch.mask,
            ),
        }
        loss = losses["spectrum"] + self.config.subspace_weight * losses["subspace"]
        if result.logits is not None:
            losses["count"] = F.cross_entropy(result.logits, count)
            loss = loss + self.config.count_weight * losses["count"]
        return {"loss": loss, **losses}

    def scores(self, batch: RegressionBatch) -> dict[str, Tensor]:
        """Errors of the peaks as the service picks them, the counts known, on a grid of a degree.

        Pairs are matched; a talker whom no peak is left for counts 90 degrees.
        """
        count = batch.mask.sum(-1)
        grid = torch.from_numpy(azimuth_grid(SCORED_GRID).astype(np.float32)).to(batch.grid.device)
        products = rotated_products(self.array, batch.rotation, grid[None])[0]
        counts = self.config.count_weight > 0
        result = self.model(batch.features, products, count, counts=counts)
        errors = [
            maae(np.array([peak.azimuth for peak in find_peaks(fused, len(truth))]), truth)
            for fused, truth in zip(result.fused.cpu().numpy(), _truths(batch), strict=True)
            if len(truth)
        ]
        scores = {"error_deg": torch.rad2deg(torch.tensor(errors))}
        if result.logits is not None:
            scores["count_accuracy"] = (result.logits.argmax(-1) == count).float()
        return scores


def _truths(batch: LocatedBatch) -> list[FloatArray]:
    """The azimuths (M,) of every scene's sources."""
    rows = zip(batch.azimuth.cpu().numpy(), batch.mask.cpu().numpy(), strict=True)
    return [azimuth[mask] for azimuth, mask in rows]


def rotated_products(
    array: MicrophoneArray, rotation: Tensor, azimuth: Tensor, bins: Tensor | None = None
) -> Tensor:
    """``delay_products`` (B, F, N^2, A) for azimuths (B, A) of the array turned counter-clockwise.

    ``rotation`` is a scalar in radians; ``bins`` (F,) are all unless they are named.
    """
    positions = array.rotated(float(rotation)).positions
    delays = np.stack([steering_delays(positions, row) for row in azimuth.double().cpu().numpy()])
    frequencies = torch.from_numpy(STFT.frequencies).float()
    if bins is not None:
        frequencies = frequencies[bins.cpu()]
    return delay_products(
        torch.from_numpy(delays).to(azimuth.device), frequencies.to(azimuth.device)
    )
