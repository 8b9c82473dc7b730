"""TransMUSIC (Ji et al., 2024): a transformer over the snapshots in place of the covariance.

The transformer's output is a signal subspace. A network finds the peaks of its MUSIC spectrum, and
its eigenvalues determine the number of sources. We do not know the paper's sizes and chose them; we
also chose to average over the snapshots, as a covariance does not depend on their order.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.baselines.bands import (
    gram_planes,
)
from model_export.baselines.method import Card
from model_export.baselines.music import BandTrunk, PeakFindingNetwork
from model_export.baselines.network import scaled

CARD = Card(
    "transmusic",
    "TransMUSIC",
    "hybrid",
    "Ji et al., TransMUSIC (arXiv 2309.08174)",
    "samples of full resolution, not of one bit; ten bands from 300 to 3500 Hz side by side in a"
    " token; covariances K K^H + eps I, the projector's gradient; the mean of the bands' spectra,"
    " bounded; one set of angles per count; depth and sizes are ours",
)
DEPTH = 2
HEADS = 8
SIZE = 256
LOADING = 1e-3
"""eps, small against the entries of K"""


class SnapshotTransformer(nn.Module):
    """Maps snapshots (B, N, K, L, 2), real and imaginary part, to covariances (B, K, 2, N, N)."""

    def __init__(self, num_microphones: int, num_bands: int, width: float) -> None:
        super().__init__()
        self.shape = (num_bands, 2, num_microphones, num_microphones)
        size = HEADS * max(1, round(SIZE * width / HEADS))
        inputs = 2 * num_microphones * num_bands
        self.embedding = nn.Linear(inputs, size)
        # Each layer is initialised by itself: torch's own stack would start with copies of one.
        self.layers = nn.Sequential(
            *(
                nn.TransformerEncoderLayer(
                    size, HEADS, 4 * size, dropout=0.0, batch_first=True, norm_first=True
                )
                for _ in range(DEPTH)
            )
        )
        self.normalise = nn.LayerNorm(size)
        self.root = nn.Linear(size, num_bands * 2 * num_microphones**2)

    def forward(self, snapshots: Tensor) -> Tensor:
        tokens = snapshots.permute(0, 3, 1, 2, 4).flatten(2)  # (B, L, N K 2)
        encoded = self.layers(self.embedding(tokens)).mean(1)
        return gram_planes(self.root(self.normalise(encoded)).unflatten(-1, self.shape), LOADING)


class TransMusicTrunk(BandTrunk):
    """The transformer on the matched track's features."""

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        network = SnapshotTransformer(num_microphones, len(self.bins), width)
        super().__init__(network, torch.view_as_real)


class TransMusic(PeakFindingNetwork):
    """TransMUSIC as cited."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        network = SnapshotTransformer(num_microphones, len(self.bins), width)
        super().__init__(network, num_microphones, scaled(SIZE, width))
