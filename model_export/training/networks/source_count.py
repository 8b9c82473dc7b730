"""The count branch beside the encoder."""

from __future__ import annotations

from torch import Tensor, nn

from model_export.training.networks import LATENT
from model_export.training.networks.encoder import ConvBlock
from service.inference.results import MAX_SOURCES


class SourceCountNetwork(nn.Module):
    """The parallel branch: maps features (B, 2N, 257, 64) to logits (B, 5) of 0 to 4 sources."""

    def __init__(self, num_microphones: int, max_sources: int = MAX_SOURCES) -> None:
        super().__init__()
        self.blocks = nn.Sequential(
            ConvBlock(2 * num_microphones, 16),  # (B, 16, 128, 32)
            ConvBlock(16, 16),  # (B, 16, 64, 16)
            ConvBlock(16, 16),  # (B, 16, 32, 8)
            ConvBlock(16, 32),  # (B, 32, 16, 4)
        )
        self.classifier = nn.Sequential(
            nn.Flatten(),  # (B, 2048)
            nn.Linear(32 * LATENT, 128),  # (B, 128)
            nn.LeakyReLU(0.1),
            nn.Linear(128, max_sources + 1),  # (B, 5)
        )

    def forward(self, features: Tensor) -> Tensor:
        logits: Tensor = self.classifier(self.blocks(features))
        return logits
