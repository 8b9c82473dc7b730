"""TransMUSIC (Ji et al., 2024): a transformer over the snapshots in the place of the covariance.

The transformer's output is a signal subspace, MUSIC's spectrum of it goes to a network that finds
the peaks, and the subspace's eigenvalues tell the number of sources. The paper's sizes are not
known to us; they are chosen here, and so is the mean over the snapshots, of which a covariance does
not know the order.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from model_export.baselines.bands import (
    CITED_BANDS,
    MATCHED_BANDS,
    band_bins,
    band_snapshots,
    gram_planes,
    matched_snapshots,
)
from model_export.baselines.method import Card
from model_export.baselines.music import HybridNetwork, Music, PeakFinder
from model_export.baselines.network import Prediction, scaled
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

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
"""eps, against entries of K that training sets"""


class SnapshotTransformer(nn.Module):
    """Snapshots (B, N, K, L, 2), real and imaginary part, to covariances (B, K, 2, N, N)."""

    def __init__(self, num_microphones: int, num_bands: int, width: float) -> None:
        super().__init__()
        self.shape = (num_bands, 2, num_microphones, num_microphones)
        size = HEADS * max(1, round(SIZE * width / HEADS))
        inputs = 2 * num_microphones * num_bands
        self.embedding = nn.Linear(inputs, size)
        # Fresh layers for every depth: torch's own stack would copy one and begin with equal ones.
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


class TransMusicTrunk(nn.Module):
    """The transformer on the matched track's features, in ``MATCHED_BANDS`` bands."""

    bins: Sequence[int] = band_bins(MATCHED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.covariance = SnapshotTransformer(num_microphones, len(self.bins), width)

    def forward(self, features: Tensor) -> Tensor:
        with torch.autocast(features.device.type, enabled=False):
            covariance: Tensor = self.covariance(
                torch.view_as_real(matched_snapshots(features, self.bins))
            )
        return covariance


class TransMusic(HybridNetwork):
    """TransMUSIC as cited: snapshots in, directions out."""

    card = CARD
    learning_rate = 1e-3
    bins: Sequence[int] = band_bins(CITED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(
            SnapshotTransformer(num_microphones, len(self.bins), width),
            Music(num_microphones, self.bins),
        )
        self.peaks = PeakFinder(scaled(SIZE, width))

    def features(self, audio: FloatArray) -> FloatArray:
        """(B, N, K, 64, 2) real and imaginary parts."""
        parts: FloatArray = torch.view_as_real(band_snapshots(audio, self.bins)).numpy()
        return parts

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        result = self.music_of(features, array, counts)
        angles = self.peaks(result.spectrum.mean(1))
        return Prediction(result.count, angles=angles, projector=result.projector)
