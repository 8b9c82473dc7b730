"""SubspaceNet (Shmuel et al., TVT 2024): an autoencoder from autocorrelations to a covariance.

The paper's network (section III) maps the autocorrelation tensor of several lags, by convolutions
with anti-rectifiers and deconvolutions, to a matrix K. A differentiable subspace method takes
K K^H + eps I, which is positive by construction.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.baselines.bands import (
    gram_planes,
    lagged_covariances,
    planes,
)
from model_export.baselines.method import Card
from model_export.baselines.music import BandTrunk, HybridNetwork, Music
from model_export.baselines.network import COUNT_WEIGHT, Prediction, Truth, count_loss, scaled
from service.doa.array import MicrophoneArray

CARD = Card(
    "subspacenet",
    "SubspaceNet",
    "hybrid",
    "Shmuel, Merkofer, Revach, van Sloun, Shlezinger, SubspaceNet (arXiv 2306.02271)",
    "one network shared by ten bands from 300 to 3500 Hz; MUSIC on a grid, the mean of the bands'"
    " bounded spectra, instead of Root-MUSIC, which circular arrays have not; a periodic squared"
    " error in expectation over the spectrum around each source; the count by the eigenvalues",
)
LAGS = 8
LOADING = 1.0
"""eps"""
SHARPNESS = 20.0
"""Factor in the softmax over a MUSIC spectrum: a background at half the peak has no weight"""


class AntiRectifier(nn.Module):
    """[ReLU(x), ReLU(-x)]: twice the channels, without loss of information."""

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.cat([inputs.relu(), (-inputs).relu()], 1)


class AutocorrelationNetwork(nn.Module):
    """Maps autocorrelations (B, K, lags, 2, N, N) to covariances (B, K, 2, N, N), band by band."""

    def __init__(self, num_microphones: int, width: float) -> None:
        super().__init__()
        self.num_microphones = num_microphones
        first, second, third = (scaled(channels, width) for channels in (16, 32, 64))
        self.layers = nn.Sequential(
            nn.Conv2d(LAGS, first, 2),
            AntiRectifier(),
            nn.Conv2d(2 * first, second, 2),
            AntiRectifier(),
            nn.Conv2d(2 * second, third, 2),
            AntiRectifier(),
            nn.ConvTranspose2d(2 * third, second, 2),
            AntiRectifier(),
            nn.ConvTranspose2d(2 * second, first, 2),
            AntiRectifier(),
            nn.ConvTranspose2d(2 * first, 1, 2),
        )

    def forward(self, autocorrelation: Tensor) -> Tensor:
        size = self.num_microphones
        images = autocorrelation.flatten(0, 1).flatten(2, 3)  # (B K, lags, 2 N, N)
        # Three kernels of size two need four columns.
        images = F.pad(images, (0, max(0, 4 - size)))
        root = self.layers(images)[:, 0, :, :size]  # (B K, 2 N, N)
        root = root.unflatten(0, autocorrelation.shape[:2]).unflatten(-2, (2, size))
        return gram_planes(root, LOADING)


def autocorrelations(snapshots: Tensor) -> Tensor:
    """Autocorrelations (B, K, lags, 2, N, N) of snapshots (B, N, K, L)."""
    return planes(lagged_covariances(snapshots, LAGS))


class SubspaceNetTrunk(BandTrunk):
    """The autoencoder on autocorrelations of the matched track's features."""

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(AutocorrelationNetwork(num_microphones, width), autocorrelations)


class SubspaceNet(HybridNetwork):
    """SubspaceNet as cited: autocorrelations in, a MUSIC spectrum out."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        network = AutocorrelationNetwork(num_microphones, width)
        super().__init__(network, Music(num_microphones, self.bins), autocorrelations)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        result = self.music_of(features, array, counts)
        return Prediction(
            result.count, spectrum=result.spectrum.mean(1), projector=result.projector
        )

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        """Root of the expected squared periodic error, and the count's cross entropy."""
        assert prediction.spectrum is not None
        error = expected_square(prediction.spectrum, truth)
        return (error + 1e-9).sqrt() + COUNT_WEIGHT * count_loss(prediction, truth)


def expected_square(spectrum: Tensor, truth: Truth) -> Tensor:
    """Squared periodic error in radians squared of directions drawn from spectra (B, A).

    Every angle belongs to its nearest source, which settles the permutation, and the softmax over a
    source's angles is the distribution of its direction. A soft argmax in a narrow window would
    ignore peaks elsewhere and have no error for a flat spectrum; the expected error does neither.
    """
    device = spectrum.device
    grid = torch.arange(spectrum.shape[-1], device=device) * (2 * torch.pi / spectrum.shape[-1])
    gap = torch.remainder(grid - truth.azimuth[..., None] + torch.pi, 2 * torch.pi) - torch.pi
    square = gap.square().masked_fill(~truth.mask[..., None], torch.inf)  # (B, M, A)
    nearest, owner = square.min(1)  # (B, A)
    sources = torch.arange(truth.mask.shape[1], device=device)[:, None]
    owned = truth.mask[..., None] & (owner[:, None] == sources)
    logits = (SHARPNESS * spectrum)[:, None].masked_fill(~owned, -torch.inf)
    # Absent sources own no angle; a softmax over no angle would be undefined.
    logits = logits.masked_fill(~truth.mask[..., None], 0.0)
    error = torch.where(owned, logits.softmax(-1) * nearest[:, None], 0.0).sum(-1)  # (B, M)
    return error.sum() / truth.mask.sum().clamp(min=1)
