"""Last layers that learned methods share."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.baselines.network import GRID_SIZE, MAX_TALKERS, Prediction


def spectrum_layer(inputs: int, grid_size: int = GRID_SIZE) -> nn.Linear:
    """Linear layer from an embedding (B, D) to the logits (B, A) of a spectrum."""
    layer = nn.Linear(inputs, grid_size)
    # Targets are almost zero nearly everywhere.
    nn.init.constant_(layer.bias, -2.0)
    return layer


class SpectrumHead(nn.Module):
    """Maps an embedding (B, D) to a spectrum in (0, 1) and count logits."""

    def __init__(self, inputs: int, grid_size: int = GRID_SIZE) -> None:
        super().__init__()
        self.spectrum = spectrum_layer(inputs, grid_size)
        self.count = nn.Linear(inputs, MAX_TALKERS + 1)

    def forward(self, embedding: Tensor) -> Prediction:
        return Prediction(self.count(embedding), spectrum=torch.sigmoid(self.spectrum(embedding)))


class DirectionHead(nn.Module):
    """Maps an embedding (B, D) to directions for every possible count, and count logits.

    A regressed direction has no confidence that would tell a second source from none. Every count
    therefore has its own outputs, like one model per count on a shared trunk. ``kind`` is
    ``"vectors"`` (x and y) or ``"angles"`` (radians, a half turn times the output).
    """

    def __init__(self, inputs: int, kind: str = "vectors") -> None:
        super().__init__()
        self.kind = kind
        size = 2 if kind == "vectors" else 1
        self.directions = nn.ModuleList(
            nn.Linear(inputs, count * size) for count in range(1, MAX_TALKERS + 1)
        )
        self.count = nn.Linear(inputs, MAX_TALKERS + 1)

    def forward(self, embedding: Tensor) -> Prediction:
        outputs = [linear(embedding) for linear in self.directions]
        if self.kind == "vectors":
            vectors = tuple(output.unflatten(-1, (-1, 2)) for output in outputs)
            return Prediction(self.count(embedding), vectors=vectors)
        angles = tuple(torch.pi * output for output in outputs)
        return Prediction(self.count(embedding), angles=angles)
