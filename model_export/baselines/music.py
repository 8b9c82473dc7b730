"""MUSIC behind networks that estimate covariances, and the count of sources by eigenvalues."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from model_export.baselines.bands import (
    CITED_BANDS,
    MATCHED_BANDS,
    band_bins,
    band_snapshots,
    matched_snapshots,
)
from model_export.baselines.network import GRID_SIZE, MAX_TALKERS, BaselineNetwork, Prediction
from model_export.training.regression import counted_projector
from model_export.training.subspace import delay_products, signal_power
from model_export.training.task import STFT, steering_delays
from service.doa.array import MicrophoneArray
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray

LOG_FLOOR = -3.2
"""Log of the floor of MUSIC's denominator, about 0.04: the initial width of the peaks"""


def array_products(array: MicrophoneArray, azimuth: Tensor, frequencies: FloatArray) -> Tensor:
    """``delay_products`` (B, F, N^2, A) of azimuths (B, A) in radians."""
    delays = [steering_delays(array.positions, row) for row in azimuth.double().cpu().numpy()]
    return delay_products(
        torch.from_numpy(np.stack(delays)).to(azimuth.device),
        torch.from_numpy(frequencies).float().to(azimuth.device),
    )


def music_spectrum(
    projector: Tensor, array: MicrophoneArray, frequencies: FloatArray, floor: Tensor
) -> Tensor:
    """MUSIC spectra (B, F, 360) of signal projectors (B, F, N, N), with a maximum of 1."""
    grid = torch.from_numpy(azimuth_grid(GRID_SIZE)).to(projector.device)
    products = array_products(array, grid[None], frequencies)[0]
    # Bins come first because the scenes share a bin's steering vectors.
    power = signal_power(projector.transpose(0, 1), products)  # (F, B, A)
    spectrum = 1 / (1 - power.clamp(max=1) + floor)
    return (spectrum / spectrum.amax(-1, keepdim=True)).transpose(0, 1)


@dataclass(frozen=True, slots=True)
class MusicResult:
    """MUSIC's results on covariances in K bands."""

    count: Tensor
    """(B, MAX_TALKERS + 1) logits"""
    projector: Tensor
    """(B, K, N, N) complex projectors onto the signal subspaces"""
    covariance: Tensor
    """(B, K, N, N) complex, the given covariances"""
    spectrum: Tensor
    """(B, K, 360) in (0, 1]"""


class Music(nn.Module):
    """Maps covariances to MUSIC spectra; eigenvalues decide the count if none is given."""

    log_floor: Tensor

    def __init__(
        self, num_microphones: int, bins: Sequence[int], *, learned_floor: bool = True
    ) -> None:
        super().__init__()
        self.frequencies = STFT.frequencies[list(bins)]
        self.count = EigenvalueCount(num_microphones, len(bins))
        floor = torch.tensor(LOG_FLOOR)
        if learned_floor:
            self.log_floor = nn.Parameter(floor)
        else:
            self.register_buffer("log_floor", floor)

    def forward(
        self, parts: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> MusicResult:
        """``parts`` are real and imaginary parts (B, K, 2, N, N) of Hermitian matrices."""
        covariance = torch.complex(parts[:, :, 0], parts[:, :, 1])
        logits = self.count(covariance)
        projector = counted_projector(covariance, logits.argmax(-1) if counts is None else counts)
        floor = self.log_floor.exp()
        spectrum = music_spectrum(projector, array, self.frequencies, floor)
        return MusicResult(logits, projector, covariance, spectrum)


class EigenvalueCount(nn.Module):
    """Source count from all bands' eigenvalues: maps (B, K, N, N) to logits.

    DA-MUSIC and TransMUSIC use such a classifier for an unknown count. Unlike those of
    eigenvectors, the derivatives of eigenvalues need no gaps.
    """

    def __init__(self, num_microphones: int, num_bands: int, hidden: int = 64) -> None:
        super().__init__()
        self.classifier = nn.Sequential(
            nn.BatchNorm1d(num_microphones * num_bands),
            nn.Linear(num_microphones * num_bands, hidden),
            nn.ReLU(),
            nn.Linear(hidden, MAX_TALKERS + 1),
        )

    def forward(self, covariance: Tensor) -> Tensor:
        values = torch.linalg.eigvalsh(covariance)  # (B, K, N), ascending
        relative = values / values.abs().amax(-1, keepdim=True).clamp(min=1e-12)
        logits: Tensor = self.classifier(relative.flatten(1))
        return logits


class BandTrunk(nn.Module):
    """A covariance network on the matched track's features, in ``MATCHED_BANDS`` bands.

    Parameters
    ----------
    covariance : Module
        Network from its input to real and imaginary parts (B, K, 2, N, N).
        sees : callable
            Maps snapshots (B, N, K, L) complex to the network's input.
    """

    bins: Sequence[int] = band_bins(MATCHED_BANDS)

    def __init__(self, covariance: nn.Module, sees: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.covariance = covariance
        self._sees = sees

    def forward(self, features: Tensor) -> Tensor:
        with torch.autocast(features.device.type, enabled=False):
            snapshots = matched_snapshots(features, self.bins)
            covariance: Tensor = self.covariance(self._sees(snapshots))
        return covariance


class HybridNetwork(BaselineNetwork):
    """A network that estimates the covariances of K bands, and MUSIC on them.

    It takes the parameters of ``BandTrunk``; features are the network's input in ``CITED_BANDS``.
    """

    steered = True
    bins: Sequence[int] = band_bins(CITED_BANDS)

    def __init__(
        self, covariance: nn.Module, music: Music, sees: Callable[[Tensor], Tensor]
    ) -> None:
        super().__init__()
        self.covariance = covariance
        self.music = music
        self._sees = sees

    def features(self, audio: FloatArray) -> FloatArray:
        seen: FloatArray = self._sees(band_snapshots(audio, self.bins)).numpy()
        return seen

    def music_of(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> MusicResult:
        """MUSIC on the covariances (B, K, 2, N, N) of features (B, ...)."""
        result: MusicResult = self.music(self.covariance(features), array, counts)
        return result


class PeakFindingNetwork(HybridNetwork):
    """Maps snapshots to directions: a small network finds the peaks of MUSIC's spectrum.

    Features are the snapshots' real and imaginary parts (B, N, K, 64, 2).
    """

    def __init__(self, covariance: nn.Module, num_microphones: int, hidden: int) -> None:
        super().__init__(covariance, Music(num_microphones, self.bins), torch.view_as_real)
        self.peaks = PeakFinder(hidden)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        result = self.music_of(features, array, counts)
        angles = self.peaks(result.spectrum.mean(1))
        return Prediction(result.count, angles=angles, projector=result.projector)


class PeakFinder(nn.Module):
    """Maps MUSIC spectra (B, 360) to angles: three hidden layers, as in DA-MUSIC, then M outputs.

    Every count has its own outputs, as in ``model_export.baselines.heads.DirectionHead``.
    """

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(GRID_SIZE, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
        )
        self.directions = nn.ModuleList(
            nn.Linear(hidden, count) for count in range(1, MAX_TALKERS + 1)
        )

    def forward(self, spectrum: Tensor) -> tuple[Tensor, ...]:
        """Angles (B, M) in radians for 1, 2, ... sources."""
        hidden = self.layers(spectrum)
        return tuple(torch.pi * linear(hidden) for linear in self.directions)
