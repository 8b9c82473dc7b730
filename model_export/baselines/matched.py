"""The matched track: our input, targets, augmentation and count branch; only the trunk differs.

A trunk is a module that maps the paper's features (B, 2N, 257, 64) of
``service.doa.spectrogram.spectrogram_features`` to an embedding (B, D), D being its attribute
``outputs``, or to covariances (B, F, 2, N, N), real and imaginary part, of the F bins in its
attribute ``bins``. A linear layer maps embeddings to the spectrum; covariances go through EVD,
MUSIC and frequency attention fusion, as NeuralMUSIC's own do.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from model_export.baselines.heads import spectrum_layer
from model_export.baselines.method import Card
from model_export.baselines.music import LOG_FLOOR, array_products, music_spectrum
from model_export.baselines.network import MAX_TALKERS, BaselineNetwork, Prediction, Truth
from model_export.training.networks import NUM_FRAMES
from model_export.training.networks.fusion import FrequencyAttentionFusion
from model_export.training.networks.source_count import SourceCountNetwork
from model_export.training.precision import training_precision
from model_export.training.regression import counted_projector, subspace_distance
from model_export.training.task import STFT
from service.doa.array import MicrophoneArray
from service.doa.spectrogram import spectrogram_features
from service.doa.types import FloatArray


def matched_features(audio: FloatArray) -> FloatArray:
    """Features (B, 2N, 257, 64) float32 of windows (B, N, T), T at least 64 frames."""
    return spectrogram_features(STFT.transform(audio)[..., :NUM_FRAMES])


class MatchedNetwork(BaselineNetwork):
    """A trunk beside the paper's count branch."""

    def __init__(self, trunk: nn.Module, num_microphones: int, card: Card) -> None:
        super().__init__()
        self.card = card  # type: ignore[misc]
        self.trunk = trunk
        self.count = SourceCountNetwork(num_microphones, MAX_TALKERS)

    def features(self, audio: FloatArray) -> FloatArray:
        return matched_features(audio)

    def both(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Outputs of the trunk and logits of the count, float32."""
        with training_precision(features, training=self.training):
            features = features.contiguous(memory_format=torch.channels_last)
            found, logits = self.trunk(features), self.count(features)
        return found.float(), logits.float()


class MatchedSpectrum(MatchedNetwork):
    """A trunk that outputs an embedding, and one linear layer to 360 angles."""

    def __init__(self, trunk: nn.Module, num_microphones: int, card: Card) -> None:
        super().__init__(trunk, num_microphones, card)
        self.spectrum = spectrum_layer(trunk.outputs)  # type: ignore[arg-type]

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        embedding, logits = self.both(features)
        return Prediction(logits, spectrum=torch.sigmoid(self.spectrum(embedding)))


class MatchedSubspace(MatchedNetwork):
    """A trunk that estimates covariances, followed by MUSIC and FAF."""

    steered = True

    def __init__(
        self, trunk: nn.Module, num_microphones: int, card: Card, *, attention: bool = True
    ) -> None:
        super().__init__(trunk, num_microphones, card)
        self.frequencies = STFT.frequencies[np.asarray(trunk.bins)]
        self.fusion = FrequencyAttentionFusion(len(self.frequencies)) if attention else None
        self.log_floor = nn.Parameter(torch.tensor(LOG_FLOOR))

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        parts, logits = self.both(features)
        covariance = torch.complex(parts[:, :, 0], parts[:, :, 1])  # (B, F, N, N)
        projector = counted_projector(covariance, logits.argmax(-1) if counts is None else counts)
        floor = self.log_floor.exp()
        spectrum = music_spectrum(projector, array, self.frequencies, floor)  # (B, F, A)
        fused = spectrum.mean(1) if self.fusion is None else self.fusion(spectrum)
        return Prediction(logits, spectrum=fused, projector=projector)

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        assert prediction.projector is not None
        products = array_products(array, truth.azimuth, self.frequencies)
        subspace = subspace_distance(prediction.projector, products, truth.mask)
        return super().loss(prediction, truth, array) + subspace
