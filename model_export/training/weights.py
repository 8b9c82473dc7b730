"""The `weights` variant: time-frequency weights from array-independent features.

The network sees no geometry. Its outputs, a weight and an attention per time-frequency cell, form
covariances of any array outside of it; EVD, MUSIC and fusion follow as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.training.config import Trunk
from model_export.training.precision import training_precision
from model_export.training.subspace import dominance, signal_power, signal_projector
from service.doa.features import NUM_FEATURES
from service.inference.weights import BLOCK_FRAMES, CELL_LOADING, kept_blocks

BINS_PER_ROW = 4
CHANNELS = 32
"""Channels of the causal blocks and the heads"""
NORM_MOMENTUM = 0.02
"""Momentum of the running means; torch's 0.1 lets a few odd batches raise the errors"""
WINDOW_SHARE = 0.5
"""Attention of a bin's whole window relative to the sum of its blocks'. The cross entropy would
learn a tenth, since blocks tell talkers apart; in strong noise the longer average errs less."""
KEPT_SHARE = 0.25
"""Share of a bin's blocks that is kept, by attention; the others count next to nothing"""


class PastContext(nn.Module):
    """Residual causal convolution in time, over the previous ``2 * dilation`` frames of a row."""

    looks_ahead = False

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.inputs, self.stride, self.reach = channels, 1, 2 * dilation
        self.convolution = nn.Conv2d(channels, channels, (3, 1), dilation=(dilation, 1), bias=False)
        self.norm = nn.BatchNorm2d(channels, momentum=NORM_MOMENTUM)

    def forward(self, hidden: Tensor) -> Tensor:
        return self.step(after_silence(hidden, self.reach), hidden)

    def step(self, joined: Tensor, hidden: Tensor) -> Tensor:
        """Output for the frames ``hidden``; ``joined`` has ``reach`` frames before them, too."""
        return F.relu(hidden + self.norm(self.convolution(joined)))


class BandContext(nn.Module):
    """Residual causal convolution in time of the mean over all rows of the band."""

    def __init__(self, channels: int, length: int = 5) -> None:
        super().__init__()
        self.reach = length - 1
        self.first = nn.Conv1d(channels, channels, length)
        self.second = nn.Conv1d(channels, channels, length)

    def forward(self, hidden: Tensor) -> Tensor:
        band = self.convolve(after_silence(self.mean(hidden), self.reach))
        return self.step(after_silence(band, self.reach), hidden)

    @staticmethod
    def mean(hidden: Tensor) -> Tensor:
        """Mean (B, C, L, 1) over the rows of (B, C, L, R)."""
        return F.avg_pool2d(hidden, (1, hidden.shape[3]))

    def convolve(self, band: Tensor) -> Tensor:
        """Apply the first convolution to ``band`` (B, C, reach + L, 1)."""
        return F.relu(_along_time(band, self.first))

    def step(self, band: Tensor, hidden: Tensor) -> Tensor:
        """Add the second convolution of ``band`` (B, C, reach + L, 1) to ``hidden``'s rows."""
        # Enlarging an image of one row lets onnxruntime keep its blocked layout throughout.
        scale = (1.0, float(hidden.shape[3]))
        band = _along_time(band, self.second)
        return hidden + F.interpolate(band, scale_factor=scale, mode="nearest")


def after_silence(hidden: Tensor, frames: int) -> Tensor:
    """Prepend ``frames`` zeros to (B, C, L, R) along L."""
    return F.pad(hidden, (0, 0, frames, 0))


def _along_time(image: Tensor, convolution: nn.Conv1d) -> Tensor:
    """Apply a convolution along the frames of (B, C, L, 1)."""
    return F.conv2d(image, convolution.weight[..., None], convolution.bias)


class Ahead(nn.Sequential):
    """Convolution over three frames, one of them ahead, and ``width`` bins or rows."""

    looks_ahead = True

    def __init__(self, inputs: int, outputs: int, width: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(
                inputs,
                outputs,
                (3, width),
                stride=(1, stride),
                padding=(0, (width - stride + 1) // 2),
                bias=False,
            ),
            nn.BatchNorm2d(outputs, momentum=NORM_MOMENTUM),
            nn.ReLU(),
        )
        self.inputs, self.stride, self.reach = inputs, stride, 2

    def forward(self, hidden: Tensor) -> Tensor:
        return self.step(between_silence(hidden), hidden)

    def step(self, joined: Tensor, _hidden: Tensor) -> Tensor:
        """Output for the L inner frames of ``joined`` (B, C, 1 + L + 1, R)."""
        result: Tensor = super().forward(joined)
        return result


class Separable(nn.Module):
    """Residual separable ``Ahead``: a convolution of each channel, then one across the channels.

    It takes a fifth of a dense convolution's operations and a quarter of its time.
    """

    looks_ahead = True

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.inputs, self.stride, self.reach = channels, 1, 2
        self.rows = nn.Conv2d(
            channels, channels, (3, width), padding=(0, width // 2), groups=channels, bias=False
        )
        self.mix = nn.Conv2d(channels, channels, 1, bias=False)
        self.norm = nn.BatchNorm2d(channels, momentum=NORM_MOMENTUM)

    def forward(self, hidden: Tensor) -> Tensor:
        return self.step(between_silence(hidden), hidden)

    def step(self, joined: Tensor, hidden: Tensor) -> Tensor:
        """Output for the frames ``hidden``; ``joined`` has a frame before and after them, too."""
        return F.relu(hidden + self.norm(self._convolve(joined)))

    def _convolve(self, joined: Tensor) -> Tensor:
        if not (self.training and self.rows.weight.requires_grad):
            mixed: Tensor = self.mix(self.rows(joined))
            return mixed
        # One dense convolution gives the same, and a CPU computes its gradients in half the time.
        dense = self.mix.weight * self.rows.weight[:, 0]
        return F.conv2d(joined, dense, padding=self.rows.padding)


def between_silence(hidden: Tensor) -> Tensor:
    """Add a frame of zeros before and after (B, C, L, R) along L."""
    return F.pad(hidden, (0, 0, 1, 1))


def _ahead(trunk: Trunk) -> list[nn.Module]:
    """Convolutions that look ahead, one frame each; their output is (B, 32, L, F/4)."""
    if trunk == "strided":
        return [
            Ahead(NUM_FEATURES + 1, 24, 5, 2),
            Ahead(24, 32, 5, 2),
            Ahead(32, 40),
            Ahead(40, CHANNELS),
        ]
    # One strided convolution reads a row's four bins and both neighbours' without copies.
    first = Ahead(NUM_FEATURES + 1, CHANNELS, 3 * BINS_PER_ROW, BINS_PER_ROW)
    return [first, *(Separable(CHANNELS, 5) for _ in range(3))]


class WeightsNetwork(nn.Module):
    """Convolutions without pooling in time: maps features to weights and attentions.

    The input is (B, 5, L, F), F a multiple of 4. The outputs are weights in (0, 1) and attentions
    in (0, inf), each (B, L, F). Frames come before bins, so that a stream's few frames are long
    rows. Four convolutions look one frame ahead each, so a stream's newest results are at most
    64 ms late.

    Parameters
    ----------
    trunk : str
        ``"strided"`` reduces four bins to one row by two strides and has dense convolutions only.
        ``"separable"`` reduces them by one stride, has separable convolutions after it and costs
        half as much (docs/performance.md).
    """

    def __init__(self, trunk: Trunk = "strided") -> None:
        super().__init__()
        ahead = _ahead(trunk)
        self.lookahead = len(ahead)
        self.blocks = nn.Sequential(
            *ahead,
            PastContext(CHANNELS, 2),
            BandContext(CHANNELS),
            PastContext(CHANNELS, 4),
            PastContext(CHANNELS, 8),
        )
        self.head = nn.Conv2d(CHANNELS, 2 * BINS_PER_ROW, 1)
        self.share_head = nn.Conv2d(CHANNELS, BINS_PER_ROW, 1)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.cells(self.hidden(features))

    def hidden(self, features: Tensor) -> Tensor:
        """Input (B, 32, L, F/4) of both heads."""
        hidden: Tensor = self.blocks(self.image(features))
        return hidden

    def image(self, features: Tensor) -> Tensor:
        """Input of the first convolution: the features and each bin's place in the band."""
        batch, _, frames, bins = features.shape
        # An array's resolution depends on the frequency, which the convolutions cannot see.
        height = torch.linspace(-1, 1, bins, device=features.device, dtype=features.dtype)
        return torch.cat([features, height.expand(batch, 1, frames, bins)], 1)

    def cells(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Weights and attentions of every cell, each (B, L, F)."""
        cells = _every_bin(self.head(hidden), 2)
        return torch.sigmoid(cells[:, 0]), _softplus(cells[:, 1])

    def direct_share(self, hidden: Tensor) -> Tensor:
        """Logits (B, L, F) of the strongest direct sound's share in a cell, for training only."""
        return _every_bin(self.share_head(hidden), 1)[:, 0]


def _softplus(logits: Tensor) -> Tensor:
    """log(1 + e^x) by vectorised operations; onnxruntime's Softplus takes five times as long."""
    return F.relu(logits) + torch.log(1 + torch.exp(-logits.abs()))


def _every_bin(rows: Tensor, outputs: int) -> Tensor:
    """Reshape (B, outputs * 4, L, F/4) to (B, outputs, L, F)."""
    batch, _, frames, width = rows.shape
    cells = rows.reshape(batch, outputs, BINS_PER_ROW, frames, width)
    return cells.permute(0, 1, 3, 4, 2).reshape(batch, outputs, frames, width * BINS_PER_ROW)


@dataclass(frozen=True, slots=True)
class FusedSpectrum:
    """Outputs of the differentiable pipeline."""

    fused: Tensor
    """(B, A) in (0, 1)"""
    sharpness: Tensor
    """Scalar, the softmax's factor"""
    direct_share: Tensor
    """(B, F, L) logits"""


class WeightsPipeline(nn.Module):
    """Weights network, block covariances, rank-one MUSIC and fusion over frequency and time."""

    def __init__(self, trunk: Trunk = "strided") -> None:
        super().__init__()
        self.network = WeightsNetwork(trunk)
        self.log_floor = nn.Parameter(torch.tensor(-4.5))
        """Log of MUSIC's floor at a resolution of 1, which sets the width of the peaks"""
        self.log_dominance_power = nn.Parameter(torch.tensor(0.0))
        """Log of the exponent of the dominance in the attention"""
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
            Products from ``delay_products``.
            resolution : (B,) real
                Resolutions of the arrays, from ``service.doa.steering.resolution``.
            bins : (F',) integer, optional
                Bins of ``spectra`` among those of the features, by default all. In training half of
                them teach as much at half the cost.
        """
        # The rest needs the precision of float32.
        with training_precision(features, training=self.training):
            image = features.transpose(2, 3).contiguous(memory_format=torch.channels_last)
            hidden = self.network.hidden(image)
            share = self.network.direct_share(hidden)
            weights, attention = self.network.cells(hidden)
        share, weights, attention = (
            each.float().transpose(1, 2) for each in (share, weights, attention)
        )
        if bins is not None:
            weights, attention = weights[:, bins], attention[:, bins]
        blocks = block_covariances(spectra, weights)  # (B, F, K, N, N)
        # Blocks tell talkers apart; the whole window, their sum, averages out more of the noise.
        covariance = torch.cat([blocks, blocks.sum(2, keepdim=True)], 2)
        projector = signal_projector(covariance, 1)
        power = signal_power(projector, products)  # (B, F, K, A)
        floor = self.log_floor.exp() * resolution[:, None, None, None]
        spectrum = 1 / (1 - power.clamp(max=1) + floor)
        spectrum = spectrum / spectrum.amax(-1, keepdim=True)
        attended = attention.unflatten(-1, (-1, BLOCK_FRAMES)).mean(-1)  # (B, F, K)
        whole = attended.sum(-1, keepdim=True) * WINDOW_SHARE
        attended = _strongest(attended)
        quality = dominance(covariance, projector).clamp(1e-4, 1)
        cells = torch.cat([attended, whole], -1) * quality ** self.log_dominance_power.exp()
        total = cells.sum((1, 2)).clamp(min=1e-6)
        fused = torch.einsum("bfk,bfka->ba", cells, spectrum) / total[:, None]
        return FusedSpectrum(fused, self.log_sharpness.exp(), share)


def _strongest(attended: Tensor) -> Tensor:
    """Attentions (..., K) without the weak blocks, whose spectra the service does not compute."""
    least = attended.topk(kept_blocks(attended.shape[-1], KEPT_SHARE), -1).values[..., -1:]
    return attended * (attended >= least)


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
