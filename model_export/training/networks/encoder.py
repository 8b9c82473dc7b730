"""The encoder: features to latent covariance features, one channel per frequency bin."""

from __future__ import annotations

from torch import nn

from model_export.training.networks import NUM_BINS


def conv_block(inputs: int, outputs: int) -> nn.Sequential:
    """(B, inputs, H, W) -> (B, outputs, H // 2, W // 2)."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.BatchNorm2d(outputs),
        # A maximum and a ReLU commute; in this order the ReLU works on a quarter of the cells.
        nn.MaxPool2d(2),
        nn.ReLU(),
    )


class Encoder(nn.Sequential):
    """Features to latent covariance features, one channel of the last block per frequency bin.

    The last block's channel f stands for bin f: pooling divides the input's frequency axis by
    sixteen, and only training pairs the channels with the bins' steering vectors. The encoder is a
    module of its own so that pretrained weights can be loaded into it.
    """

    def __init__(self, num_microphones: int) -> None:
        super().__init__(
            conv_block(2 * num_microphones, 64),  # (B, 2N, 257, 64) -> (B, 64, 128, 32)
            conv_block(64, 64),  # (B, 64, 64, 16)
            conv_block(64, 64),  # (B, 64, 32, 8)
            conv_block(64, NUM_BINS),  # (B, 257, 16, 4)
            nn.Flatten(2),  # (B, 257, 64)
        )
