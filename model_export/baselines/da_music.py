"""DA-MUSIC (Merkofer et al., TVT 2023): a recurrent network in place of the sample covariance.

In the paper (section III) a GRU reads the snapshots, its last state is mapped to an N x N matrix,
MUSIC uses the noise subspace of it, and a small network finds the spectrum's peaks.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.baselines.bands import (
    hermitian_planes,
)
from model_export.baselines.method import Card
from model_export.baselines.music import BandTrunk, PeakFindingNetwork
from model_export.baselines.network import scaled

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
    """Maps snapshots (B, N, K, L, 2), real and imaginary part, to covariances (B, K, 2, N, N)."""

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


class DaMusicTrunk(BandTrunk):
    """The GRU on the matched track's features."""

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        network = SnapshotGru(num_microphones, len(self.bins), width)
        super().__init__(network, torch.view_as_real)


class DaMusic(PeakFindingNetwork):
    """DA-MUSIC as cited."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        bands = len(self.bins)
        hidden = scaled(2 * num_microphones * bands, width)
        super().__init__(SnapshotGru(num_microphones, bands, width), num_microphones, hidden)
