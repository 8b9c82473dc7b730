"""DA-MUSIC (Merkofer et al., TVT 2023): a recurrent network in the place of the covariance.

The paper's network (section III) reads the snapshots with a GRU, maps its last state to an N x N
matrix, takes MUSIC's noise subspace of it and finds the spectrum's peaks with a small network.
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
    hermitian_planes,
    matched_snapshots,
)
from model_export.baselines.method import Card
from model_export.baselines.music import HybridNetwork, Music, PeakFinder
from model_export.baselines.network import Prediction, scaled
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "da_music",
    "DA-MUSIC",
    "hybrid",
    "Merkofer, Revach, Shlezinger, Routtenberg, van Sloun, DA-MUSIC (arXiv 2109.10581)",
    "ten bands from 300 to 3500 Hz side by side, of which the GRU sees all at once and has 2N units"
    " per band; Hermitian matrices and the projector's gradient instead of a general"
    " eigendecomposition; the mean of the bands' spectra, bounded; one set of angles per count",
)


class SnapshotGru(nn.Module):
    """Snapshots (B, N, K, L, 2), real and imaginary part, to covariances (B, K, 2, N, N)."""

    def __init__(self, num_microphones: int, num_bands: int, width: float) -> None:
        super().__init__()
        self.shape = (num_bands, 2, num_microphones, num_microphones)
        inputs = 2 * num_microphones * num_bands
        hidden = scaled(inputs, width)
        self.normalise = nn.BatchNorm1d(inputs)
        self.recurrence = nn.GRU(inputs, hidden, batch_first=True)
        self.matrix = nn.Linear(hidden, num_bands * 2 * num_microphones**2)

    def forward(self, snapshots: Tensor) -> Tensor:
        rows = snapshots.movedim(-1, 1).flatten(1, 3)  # (B, 2 N K, L)
        _, last = self.recurrence(self.normalise(rows).mT)
        return hermitian_planes(self.matrix(last[0]).unflatten(-1, self.shape))


class DaMusicTrunk(nn.Module):
    """The GRU on the matched track's features, in ``MATCHED_BANDS`` bands."""

    bins: Sequence[int] = band_bins(MATCHED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.covariance = SnapshotGru(num_microphones, len(self.bins), width)

    def forward(self, features: Tensor) -> Tensor:
        with torch.autocast(features.device.type, enabled=False):
            covariance: Tensor = self.covariance(
                torch.view_as_real(matched_snapshots(features, self.bins))
            )
        return covariance


class DaMusic(HybridNetwork):
    """DA-MUSIC as cited: snapshots in, directions out."""

    card = CARD
    bins: Sequence[int] = band_bins(CITED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        bands = len(self.bins)
        super().__init__(
            SnapshotGru(num_microphones, bands, width), Music(num_microphones, self.bins)
        )
        self.peaks = PeakFinder(scaled(2 * num_microphones * bands, width))

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
