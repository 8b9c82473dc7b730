"""The encoder: features to latent covariance features, one channel per frequency bin."""

from __future__ import annotations

from torch import Tensor, nn

from model_export.training.networks import NUM_BINS


class ConvBlock(nn.Sequential):
    """Convolution, batch norm, pooling, ReLU: (B, inputs, H, W) -> (B, outputs, H // 2, W // 2)."""

    pools_first = False
    """Whether pooling comes before the norm; the same function while the norm's scale is positive
    and its statistics stand still (``model_export.training.reparametrize``)"""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1),
            nn.BatchNorm2d(outputs),
            # A maximum and a ReLU commute; in this order the ReLU meets a quarter of the cells.
            nn.MaxPool2d(2),
            nn.ReLU(),
        )

    def forward(self, cells: Tensor) -> Tensor:
        convolution, norm, pool, relu = self
        ordered = (pool, norm) if self.pools_first else (norm, pool)
        for module in (convolution, *ordered, relu):
            cells = module(cells)
        return cells


class Encoder(nn.Sequential):
    """Features to latent covariance features, one channel of the last block per frequency bin.

    The last block's channel f stands for bin f: pooling divides the input's frequency axis by
    sixteen, and only training pairs the channels with the bins' steering vectors. The encoder is a
    module of its own so that pretrained weights can be loaded into it.
    """

    def __init__(self, num_microphones: int) -> None:
        super().__init__(
            ConvBlock(2 * num_microphones, 64),  # (B, 2N, 257, 64) -> (B, 64, 128, 32)
            ConvBlock(64, 64),  # (B, 64, 64, 16)
            ConvBlock(64, 64),  # (B, 64, 32, 8)
            ConvBlock(64, NUM_BINS),  # (B, 257, 16, 4)
            nn.Flatten(2),  # (B, 257, 64)
        )
