"""DeepDAE, as the comparison calls it: convolutions over GCC-PHAT in mel bands (CNN-GCCFB)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from model_export import SAMPLE_RATE
from model_export.baselines.features import framed_spectra, gcc_filter_bank, mel_filters
from model_export.baselines.heads import SpectrumHead
from model_export.baselines.method import Card
from model_export.baselines.network import (
    COUNT_WEIGHT,
    BaselineNetwork,
    Prediction,
    Truth,
    count_loss,
    scaled,
)
from model_export.training.targets import wrapped_gaussians
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "deepdae",
    "DeepDAE",
    "learned",
    "He, Motlicek, Odobez, ICRA 2018 (arXiv 1711.11565), CNN-GCCFB: no auto-encoder",
    "correlations are averaged over the window; a count branch in place of a threshold on peaks",
)
WINDOW, HOP = 2730, 1365
"""Samples at 16 kHz, the publication's 8192 and 4096 at 48 kHz"""
LAGS = np.arange(-25, 26) * (SAMPLE_RATE / 48000)
"""Lags in samples at 16 kHz, the publication's 51 at 48 kHz, for up to 18 cm between microphones"""
NUM_BANDS, LOWEST = 40, 100.0
CHANNELS = (12, 24, 48, 96)
LIKELIHOOD_WIDTH = float(np.deg2rad(5.0))
"""Radians; sigma of exp(-d^2 / sigma^2)"""


class StridedTrunk(nn.Module):
    """Four 5 x 5 convolutions of stride 2: maps (B, C, H, W) to a flat map (B, D)."""

    def __init__(self, inputs: int, size: tuple[int, int], width: float) -> None:
        super().__init__()
        layers = nn.Sequential()
        for channels in CHANNELS:
            outputs = scaled(channels, width)
            layers.append(nn.Conv2d(inputs, outputs, 5, stride=2, padding=2))
            layers.append(nn.BatchNorm2d(outputs))
            layers.append(nn.ReLU())
            inputs, size = outputs, ((size[0] + 1) // 2, (size[1] + 1) // 2)
        self.layers = layers
        self.outputs = inputs * size[0] * size[1]

    def forward(self, features: Tensor) -> Tensor:
        embedding: Tensor = self.layers(features).flatten(1)
        return embedding


class DeepDaeTrunk(StridedTrunk):
    """The trunk of the matched track: maps (B, 2N, 257, 64) to (B, 17 x 4 x 96).

    Bins replace bands and frames replace lags. As in the publication, the next layer has separate
    weights for every place of the last map, hence for every part of the band.
    """

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(2 * num_microphones, (257, 64), width)


class DeepDae(BaselineNetwork):
    """CNN-GCCFB as cited: P pairs, 40 bands, 51 lags to 360 likelihoods; 0.57 M parameters."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        num_pairs = num_microphones * (num_microphones - 1) // 2
        self.trunk = StridedTrunk(num_pairs, (NUM_BANDS, len(LAGS)), width)
        self.head = SpectrumHead(self.trunk.outputs)

    def features(self, audio: FloatArray) -> FloatArray:
        """Features (B, P, 40, 51): correlations of pairs, bands and lags."""
        spectra = framed_spectra(audio, WINDOW, HOP, WINDOW)
        return gcc_filter_bank(spectra, mel_filters(NUM_BANDS, WINDOW, LOWEST), LAGS)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        prediction: Prediction = self.head(self.trunk(features))
        return prediction

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        assert prediction.spectrum is not None
        wanted = likelihood(truth, prediction.spectrum.shape[-1])
        squares = (prediction.spectrum - wanted).square().mean()
        return squares + COUNT_WEIGHT * count_loss(prediction, truth)


def likelihood(truth: Truth, num_angles: int) -> Tensor:
    """Likelihood (B, A): the maximum over the sources of exp(-d^2 / sigma^2), 0 without any."""
    grid = torch.arange(num_angles, device=truth.azimuth.device) * (2 * torch.pi / num_angles)
    bumps = wrapped_gaussians(truth.azimuth, grid, LIKELIHOOD_WIDTH / 2**0.5)  # (B, M, A)
    return (bumps * truth.mask[..., None]).amax(-2)
