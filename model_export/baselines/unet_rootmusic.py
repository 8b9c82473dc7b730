"""UNet-rootMUSIC (Nguyen, AEU 2024): a U-Net from impaired to ideal covariances, then MUSIC.

There is no public code; layers and sizes are the usual U-Net's (Ronneberger et al., 2015) with two
poolings, which is what matrices of a few microphones allow.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.baselines.bands import (
    hermitian_planes,
    ideal_covariance,
    lagged_covariances,
    planes,
)
from model_export.baselines.method import Card
from model_export.baselines.music import BandTrunk, HybridNetwork, Music
from model_export.baselines.network import COUNT_WEIGHT, Prediction, Truth, count_loss, scaled
from service.doa.array import MicrophoneArray

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
    """Maps sample covariances (B, K, 2, N, N) to cleaner ones, with the bands as channels."""

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


def sample_planes(snapshots: Tensor) -> Tensor:
    """Sample covariances (B, K, 2, N, N) of snapshots (B, N, K, L)."""
    return planes(lagged_covariances(snapshots, 1)[:, :, 0])


class UNetRootMusicTrunk(BandTrunk):
    """The U-Net on sample covariances of the matched track's features.

    The losses of the matched track do not prescribe the covariances.
    """

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(CovarianceUNet(len(self.bins), width), sample_planes)


class UNetRootMusic(HybridNetwork):
    """UNet-rootMUSIC as cited: trained on covariances; MUSIC comes after training."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        music = Music(num_microphones, self.bins, learned_floor=False)
        super().__init__(CovarianceUNet(len(self.bins), width), music, sample_planes)

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
