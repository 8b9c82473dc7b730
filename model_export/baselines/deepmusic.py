"""DeepMUSIC (Elbir, 2020): networks that imitate the MUSIC spectrum, one per angular sub-region.

Each of the paper's networks takes the sample covariance as an image of three channels, real part,
imaginary part and angle, and regresses the MUSIC spectrum in its sub-region.
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
    ideal_covariance,
    lagged_covariances,
    matched_snapshots,
)
from model_export.baselines.method import Card
from model_export.baselines.music import LOG_FLOOR, music_spectrum
from model_export.baselines.network import (
    COUNT_WEIGHT,
    GRID_SIZE,
    MAX_TALKERS,
    BaselineNetwork,
    Prediction,
    Truth,
    count_loss,
    scaled,
)
from model_export.training.precision import training_precision
from model_export.training.regression import counted_projector
from model_export.training.task import STFT
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "deepmusic",
    "DeepMUSIC",
    "learned",
    "Elbir, DeepMUSIC (arXiv 1912.04357)",
    "images of ten bands from 300 to 3500 Hz as channels; the target is MUSIC's bounded spectrum of"
    " the sources' ideal covariances, their mean over the bands; sigmoids instead of a softmax per"
    " sub-region, which may then be empty; eight sub-regions; batch normalisation; a count",
)
REGIONS = 8
"""Q, our choice; the re-implementation by DA-MUSIC's authors has 24, at three times the cost"""
CHANNELS = 256
UNITS = 1024


class DeepMusicTrunk(nn.Module):
    """One sub-region's network, on covariances of the matched track's features."""

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.outputs = scaled(UNITS, width)
        self.image = RegionNetwork(num_microphones, MATCHED_BANDS, width)

    def forward(self, features: Tensor) -> Tensor:
        snapshots = matched_snapshots(features, band_bins(MATCHED_BANDS))
        embedding: Tensor = self.image(covariance_images(snapshots))
        return embedding


class RegionNetwork(nn.Sequential):
    """Maps images (B, 3 K, N, N) to an embedding: four convolutions, a fully connected layer."""

    def __init__(self, num_microphones: int, num_bands: int, width: float) -> None:
        channels = scaled(CHANNELS, width)
        inputs = [3 * num_bands, channels, channels, channels]
        blocks = [
            layer
            for size, kernel in zip(inputs, (5, 5, 3, 3), strict=True)
            for layer in (
                nn.Conv2d(size, channels, kernel, padding="same"),
                nn.BatchNorm2d(channels),
                nn.ReLU(),
            )
        ]
        super().__init__(
            *blocks,
            nn.Flatten(),
            nn.Linear(channels * num_microphones**2, scaled(UNITS, width)),
            nn.ReLU(),
            nn.Dropout(0.5),
        )


class DeepMusic(BaselineNetwork):
    """DeepMUSIC as cited: covariance images in, an imitated MUSIC spectrum out."""

    card = CARD
    bins: Sequence[int] = band_bins(CITED_BANDS)

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.regions = nn.ModuleList(
            RegionNetwork(num_microphones, len(self.bins), width) for _ in range(REGIONS)
        )
        self.spectra = nn.ModuleList(
            nn.Linear(scaled(UNITS, width), GRID_SIZE // REGIONS) for _ in range(REGIONS)
        )
        self.count = nn.Linear(REGIONS * scaled(UNITS, width), MAX_TALKERS + 1)
        self.frequencies = STFT.frequencies[list(self.bins)]

    def features(self, audio: FloatArray) -> FloatArray:
        """Covariance images (B, 3 K, N, N)."""
        images: FloatArray = covariance_images(band_snapshots(audio, self.bins)).numpy()
        return images

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        with training_precision(features, training=self.training):
            images = features.contiguous(memory_format=torch.channels_last)
            embeddings = [region(images) for region in self.regions]
        embeddings = [embedding.float() for embedding in embeddings]
        parts = [
            spectrum(embedding)
            for spectrum, embedding in zip(self.spectra, embeddings, strict=True)
        ]
        return Prediction(
            self.count(torch.cat(embeddings, 1)), spectrum=torch.sigmoid(torch.cat(parts, 1))
        )

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        """Mean squared error against the ideal MUSIC spectrum, and the count's cross entropy."""
        assert prediction.spectrum is not None
        target = ideal_spectrum(array, truth, self.frequencies)
        error = (prediction.spectrum - target).square().mean()
        return error + COUNT_WEIGHT * count_loss(prediction, truth)


def covariance_images(snapshots: Tensor) -> Tensor:
    """Images (B, 3 K, N, N): real part, imaginary part and angle (half turns) of covariances."""
    covariance = lagged_covariances(snapshots, 1)[:, :, 0]
    angle = covariance.angle() / torch.pi
    return torch.cat([covariance.real, covariance.imag, angle], 1)


@torch.no_grad()
def ideal_spectrum(array: MicrophoneArray, truth: Truth, frequencies: FloatArray) -> Tensor:
    """MUSIC spectrum (B, 360) of ideal covariances, the mean over the bands.

    Its maximum is 1; without sources it is zero.
    """
    projector = counted_projector(ideal_covariance(array, truth, frequencies), truth.count)
    floor = torch.tensor(LOG_FLOOR).exp()
    spectrum = music_spectrum(projector, array, frequencies, floor).mean(1)
    peak = spectrum.amax(-1, keepdim=True)
    return spectrum / peak * (truth.count > 0)[:, None]
