"""The matched track: our input, targets, augmentation and count branch; only the trunk differs.

A trunk is a module that takes the paper's features (B, 2N, 257, 64) of
``service.doa.spectrogram.spectrogram_features`` and gives either an embedding (B, D), D being its
attribute ``outputs``, or covariances (B, F, 2, N, N), real and imaginary part, of F bins that its
attribute ``bins`` names. Embeddings get a linear layer to the spectrum; covariances go through EVD,
MUSIC and frequency attention fusion, as NeuralMUSIC's own do.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from model_export.baselines.heads import spectrum_layer
from model_export.baselines.method import Card
from model_export.baselines.network import (
    GRID_SIZE,
    MAX_SOURCES,
    BaselineNetwork,
    Prediction,
    Truth,
)
from model_export.networks import NUM_FRAMES, FrequencyAttentionFusion, SourceCountNetwork
from model_export.regression import counted_projector, subspace_distance
from model_export.subspace import delay_products, signal_power
from model_export.tasks import STFT, steering_delays
from service.doa.array import MicrophoneArray
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray


def matched_features(audio: FloatArray) -> FloatArray:
    """(B, 2N, 257, 64) float32 of windows (B, N, T), T at least 64 frames."""
    return spectrogram_features(STFT.transform(audio)[..., :NUM_FRAMES])


class MatchedSpectrum(BaselineNetwork):
    """A trunk, one linear layer to 360 angles, and the paper's count branch."""

    def __init__(self, trunk: nn.Module, num_microphones: int, card: Card) -> None:
        super().__init__()
        self.card = card  # type: ignore[misc]
        self.trunk = trunk
        self.spectrum = spectrum_layer(trunk.outputs)  # type: ignore[arg-type]
        self.count = SourceCountNetwork(num_microphones, MAX_SOURCES)

    def features(self, audio: FloatArray) -> FloatArray:
        return matched_features(audio)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        # bfloat16 halves the convolutions' cost on a CPU.
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.training):
            features = features.contiguous(memory_format=torch.channels_last)
            embedding, logits = self.trunk(features), self.count(features)
        spectrum = torch.sigmoid(self.spectrum(embedding.float()))
        return Prediction(logits.float(), spectrum=spectrum)


class MatchedSubspace(BaselineNetwork):
    """A trunk that estimates covariances, MUSIC behind it, and the paper's count branch."""

    steered = True

    def __init__(
        self, trunk: nn.Module, num_microphones: int, card: Card, *, attention: bool = True
    ) -> None:
        super().__init__()
        self.card = card  # type: ignore[misc]
        self.trunk = trunk
        self.count = SourceCountNetwork(num_microphones, MAX_SOURCES)
        self.frequencies = STFT.frequencies[np.asarray(trunk.bins)]
        self.fusion = FrequencyAttentionFusion(len(self.frequencies)) if attention else None
        self.log_floor = nn.Parameter(torch.tensor(-3.2))

    def features(self, audio: FloatArray) -> FloatArray:
        return matched_features(audio)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.training):
            features = features.contiguous(memory_format=torch.channels_last)
            parts, logits = self.trunk(features).float(), self.count(features).float()
        covariance = torch.complex(parts[:, :, 0], parts[:, :, 1])  # (B, F, N, N)
        projector = counted_projector(covariance, logits.argmax(-1) if counts is None else counts)
        products = self._products(array, torch.from_numpy(azimuth_grid(GRID_SIZE))[None])[0]
        power = signal_power(projector.transpose(0, 1), products)  # (F, B, A)
        spectrum = 1 / (1 - power.clamp(max=1) + self.log_floor.exp())
        spectrum = (spectrum / spectrum.amax(-1, keepdim=True)).transpose(0, 1)  # (B, F, A)
        fused = spectrum.mean(1) if self.fusion is None else self.fusion(spectrum)
        return Prediction(logits, spectrum=fused, projector=projector)

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        assert prediction.projector is not None
        products = self._products(array, truth.azimuth)
        subspace = subspace_distance(prediction.projector, products, truth.mask)
        return super().loss(prediction, truth, array) + subspace

    def _products(self, array: MicrophoneArray, azimuth: Tensor) -> Tensor:
        """``delay_products`` (B, F, N^2, A) of azimuths (B, A) in radians."""
        delays = [steering_delays(array.positions, row) for row in azimuth.double().numpy()]
        frequencies = torch.from_numpy(self.frequencies).float()
        return delay_products(torch.from_numpy(np.stack(delays)), frequencies)
