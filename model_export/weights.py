"""The `weights` variant: time-frequency weights from array-independent features.

The network sees no geometry. What it gives, a weight and an attention per time-frequency cell,
forms covariances of any array outside of it; EVD, MUSIC and fusion follow as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.subspace import dominance, signal_power, signal_projector
from service.doa.features import NUM_FEATURES
from service.inference.weights import BLOCK_FRAMES, CELL_LOADING

FREQUENCY_STRIDE = 4
WINDOW_SHARE = 0.5
"""Attention of a bin's whole window against the sum of its blocks'. The cross entropy would learn
a tenth: blocks tell talkers apart; but in strong noise the longer average errs less."""


class PastContext(nn.Module):
    """Residual causal convolution in time: what a bin did up to ``2 * dilation`` frames before."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.reach = 2 * dilation
        self.convolution = nn.Conv2d(channels, channels, (1, 3), dilation=(1, dilation), bias=False)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, hidden: Tensor) -> Tensor:
        past = F.pad(hidden, (self.reach, 0))
        return F.relu(hidden + self.norm(self.convolution(past)))


class BandContext(nn.Module):
    """Residual causal convolution of the band's mean: what all bins together do in time."""

    def __init__(self, channels: int, length: int = 5) -> None:
        super().__init__()
        self.reach = length - 1
        self.first = nn.Conv1d(channels, channels, length)
        self.second = nn.Conv1d(channels, channels, length)

    def forward(self, hidden: Tensor) -> Tensor:
        band = hidden.mean(2)  # (B, C, L)
        band = F.relu(self.first(F.pad(band, (self.reach, 0))))
        return hidden + self.second(F.pad(band, (self.reach, 0)))[:, :, None]


class WeightsNetwork(nn.Module):
    """Convolutions without pooling in time: features to weights and attentions.

    Input (B, 5, F, L), F a multiple of 4; output weights and attentions, each (B, F, L), in (0, 1)
    and (0, inf). It looks 4 frames ahead, so that a stream's newest results are 64 ms late at most.
    """

    def __init__(self, channels: tuple[int, int, int, int] = (24, 32, 40, 32)) -> None:
        super().__init__()
        one, two, three, four = channels

        def block(inputs: int, outputs: int, height: int, stride: int) -> nn.Sequential:
            return nn.Sequential(
                nn.Conv2d(
                    inputs,
                    outputs,
                    (height, 3),
                    stride=(stride, 1),
                    padding=(height // 2, 1),
                    bias=False,
                ),
                nn.BatchNorm2d(outputs),
                nn.ReLU(),
            )

        self.blocks = nn.Sequential(
            block(NUM_FEATURES + 1, one, 5, 2),  # (B, 24, F/2, L)
            block(one, two, 5, 2),  # (B, 32, F/4, L)
            block(two, three, 3, 1),
            block(three, four, 3, 1),
            PastContext(four, 2),
            BandContext(four),
            PastContext(four, 4),
            PastContext(four, 8),
        )
        self.head = nn.Conv2d(four, 2 * FREQUENCY_STRIDE, 1)
        self.share_head = nn.Conv2d(four, FREQUENCY_STRIDE, 1)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.cells(self.hidden(features))

    def hidden(self, features: Tensor) -> Tensor:
        """What both heads see, (B, 32, F/4, L)."""
        batch, _, bins, frames = features.shape
        # Where a bin lies decides how much an array can hear there; the convolutions cannot tell.
        height = torch.linspace(-1, 1, bins, device=features.device, dtype=features.dtype)
        height = height.reshape(1, 1, bins, 1).expand(batch, 1, bins, frames)
        hidden: Tensor = self.blocks(torch.cat([features, height], 1))
        return hidden

    def cells(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Weights and attentions of every cell, each (B, F, L)."""
        cells = _every_bin(self.head(hidden), 2)
        return torch.sigmoid(cells[:, 0]), F.softplus(cells[:, 1])

    def direct_share(self, hidden: Tensor) -> Tensor:
        """Logits (B, F, L) of the strongest direct sound's share in a cell; only training asks."""
        return _every_bin(self.share_head(hidden), 1)[:, 0]


def _every_bin(strided: Tensor, outputs: int) -> Tensor:
    """From (B, outputs * 4, F/4, L) to (B, outputs, F, L)."""
    batch, _, rows, frames = strided.shape
    cells = strided.reshape(batch, outputs, FREQUENCY_STRIDE, rows, frames)
    return cells.transpose(2, 3).reshape(batch, outputs, rows * FREQUENCY_STRIDE, frames)


@dataclass(frozen=True, slots=True)
class FusedSpectrum:
    """What the differentiable pipeline gives."""

    fused: Tensor
    """(B, A) in (0, 1)"""
    sharpness: Tensor
    """Scalar, the softmax's factor"""
    direct_share: Tensor
    """(B, F, L) logits"""


class WeightsPipeline(nn.Module):
    """Weights network, block covariances, rank-one MUSIC and fusion over frequency and time."""

    def __init__(self) -> None:
        super().__init__()
        self.network = WeightsNetwork()
        self.log_floor = nn.Parameter(torch.tensor(-4.5))
        """MUSIC's floor for an array that resolves everything: the width of the peaks"""
        self.log_dominance_power = nn.Parameter(torch.tensor(0.0))
        """Exponent of the dominance in the attention"""
        self.log_sharpness = nn.Parameter(torch.tensor(2.64))

    def forward(
        self,
        features: Tensor,
        spectra: Tensor,
        products: Tensor,
        *,
        resolution: Tensor,
        bins: Tensor | None = None,
    ) -> FusedSpectrum:
        """Fused spectrum of every scene.

        Parameters
        ----------
        features : (B, 5, F, L) real
        spectra : (B, N, F', L) complex
        products : (B, F', N^2, A) real
            From ``delay_products``.
        resolution : (B,) real
            Of the arrays, from ``service.doa.steering.resolution``.
        bins : (F',) integer, optional
            The bins of ``spectra`` among those of the features: in training a part of them says
            as much as all at half the price. By default all.
        """
        # bfloat16 halves the convolutions' cost on a CPU; what follows needs its digits.
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.training):
            hidden = self.network.hidden(features.contiguous(memory_format=torch.channels_last))
            share = self.network.direct_share(hidden)
            weights, attention = self.network.cells(hidden)
        weights, attention = weights.float(), attention.float()
        if bins is not None:
            weights, attention = weights[:, bins], attention[:, bins]
        blocks = block_covariances(spectra, weights)  # (B, F, K, N, N)
        # Blocks tell talkers apart; the whole window, their sum, averages most of the noise.
        covariance = torch.cat([blocks, blocks.sum(2, keepdim=True)], 2)
        projector = signal_projector(covariance, 1)
        power = signal_power(projector, products)  # (B, F, K, A)
        floor = self.log_floor.exp() * resolution[:, None, None, None]
        spectrum = 1 / (1 - power.clamp(max=1) + floor)
        spectrum = spectrum / spectrum.amax(-1, keepdim=True)
        attended = attention.unflatten(-1, (-1, BLOCK_FRAMES)).mean(-1)  # (B, F, K)
        whole = attended.sum(-1, keepdim=True) * WINDOW_SHARE
        quality = dominance(covariance, projector).clamp(1e-4, 1)
        cells = torch.cat([attended, whole], -1) * quality ** self.log_dominance_power.exp()
        total = cells.sum((1, 2)).clamp(min=1e-6)
        fused = torch.einsum("bfk,bfka->ba", cells, spectrum) / total[:, None]
        return FusedSpectrum(fused, self.log_sharpness.exp(), share.float())


def block_covariances(spectra: Tensor, weights: Tensor) -> Tensor:
    """Weighted covariances of blocks of 8 frames, as ``service.doa.covariance`` forms them.

    ``spectra`` (B, N, F, L) complex and ``weights`` (B, F, L) give (B, F, L / 8, N, N) complex.
    """
    power = (spectra.real**2 + spectra.imag**2).sum(1).clamp(min=1e-30)  # (B, F, L)
    scaled = spectra * (weights / power).sqrt()[:, None]
    blocks = scaled.permute(0, 2, 3, 1).unflatten(2, (-1, BLOCK_FRAMES))  # (B, F, K, 8, N)
    covariance = blocks.transpose(-1, -2) @ blocks.conj()
    identity = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
    return covariance + CELL_LOADING * identity
