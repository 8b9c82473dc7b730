"""UNet-rootMUSIC (Nguyen, AEU 2024): a U-Net from impaired to ideal covariances, then MUSIC.

There is no public code; layers and sizes are the usual U-Net's (Ronneberger et al., 2015) with two
poolings, which is what matrices of a few microphones allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.baselines.bands import (
    CITED_BANDS,
    MATCHED_BANDS,
    band_bins,
    band_snapshots,
    hermitian_planes,
    ideal_covariance,
    lagged_covariances,
    matched_snapshots,
    planes,
)
from model_export.baselines.method import Card
from model_export.baselines.music import HybridNetwork, Music
from model_export.baselines.network import COUNT_WEIGHT, Prediction, Truth, count_loss, scaled
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "unet_rootmusic",
    "UNet-rootMUSIC",
    "hybrid",
    "Nguyen, U-Net covariances for Root-MUSIC (AEU, 2024)",
    "ten bands from 300 to 3500 Hz as channels; MUSIC on a grid, the mean of the bands' bounded"
    " spectra, for arrays that are no line; the count by the eigenvalues; layers and sizes are the"
    " usual U-Net's",
)
POOLINGS = 2


class CovarianceUNet(nn.Module):
    """Sample covariances (B, K, 2, N, N) to cleaner ones of the same shape, bands as channels."""

    def __init__(self, num_bands: int, width: float) -> None:
        super().__init__()
        base = scaled(64, width)
        self.entry = _double_convolution(2 * num_bands, base)
        self.down = nn.ModuleList(
            _double_convolution(base * 2**level, base * 2 ** (level + 1))
            for level in range(POOLINGS)
        )
        self.widen = nn.ModuleList(
            nn.ConvTranspose2d(base * 2 ** (level + 1), base * 2**level, 2, stride=2)
            for level in range(POOLINGS)
        )
        self.up = nn.ModuleList(
            _double_convolution(base * 2 ** (level + 1), base * 2**level)
            for level in range(POOLINGS)
        )
        self.exit = nn.Conv2d(base, 2 * num_bands, 1)

    def forward(self, covariance: Tensor) -> Tensor:
        size = covariance.shape[-1]
        extra = -size % 2**POOLINGS
        level = self.entry(F.pad(covariance.flatten(1, 2), (0, extra, 0, extra)))
        levels = [level]
        for down in self.down:
            levels.append(down(F.max_pool2d(levels[-1], 2)))
        image = levels.pop()
        for widen, up in zip(reversed(self.widen), reversed(self.up), strict=True):
            image = up(torch.cat([levels.pop(), widen(image)], 1))
        parts = self.exit(image)[..., :size, :size].unflatten(1, covariance.shape[1:3])
        return hermitian_planes(parts)


class UNetRootMusicTrunk(nn.Module):
    """The U-Net on sample covariances of the matched track's features.

    The matched losses leave it to the network what its covariances are.
    """

    bins: Sequence[int] = band_bins(MATCHED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.covariance = CovarianceUNet(len(self.bins), width)

    def forward(self, features: Tensor) -> Tensor:
        with torch.autocast(features.device.type, enabled=False):
            sample = lagged_covariances(matched_snapshots(features, self.bins), 1)[:, :, 0]
            covariance: Tensor = self.covariance(planes(sample))
        return covariance


class UNetRootMusic(HybridNetwork):
    """UNet-rootMUSIC as cited: trained on covariances; MUSIC comes after training."""

    card = CARD
    bins: Sequence[int] = band_bins(CITED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(
            CovarianceUNet(len(self.bins), width),
            Music(num_microphones, self.bins, learned_floor=False),
        )

    def features(self, audio: FloatArray) -> FloatArray:
        """(B, K, 2, N, N)."""
        sample = lagged_covariances(band_snapshots(audio, self.bins), 1)[:, :, 0]
        parts: FloatArray = planes(sample).numpy()
        return parts

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        result = self.music_of(features, array, counts)
        return Prediction(
            result.count,
            spectrum=result.spectrum.mean(1),
            projector=result.projector,
            covariance=result.covariance,
        )

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        """Mean squared error of the covariances' entries, and the count's cross entropy."""
        assert prediction.covariance is not None
        ideal = ideal_covariance(array, truth, self.music.frequencies)
        error = planes(prediction.covariance - ideal).square().mean()
        return error + COUNT_WEIGHT * count_loss(prediction, truth)


def _double_convolution(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )
