"""DOANet: dilated convolutions on raw audio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from torch import Tensor, nn

from model_export.baselines.heads import DirectionHead
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork, Prediction, scaled
from model_export.training.precision import training_precision
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "doanet",
    "DOANet",
    "learned",
    "Qayyum et al., EURASIP J. Audio Speech Music Process. (2020)",
    "16 kHz in place of 44.1 kHz, windows of unit power, x and y per source",
)
FILTERS = (32, 64, 128, 256, 512, 1024, 1024, 2048, 2048)
KERNELS = (21, 19, 17, 15, 13, 11, 9, 9, 7)
DILATIONS = (1, 2, 3, 5, 8, 13, 21, 34, 55)
POOLINGS = {2: 3, 4: 2, 6: 2, 8: 2}
"""Steps of max-pooling after a layer, by the layer's number from 1"""
DENSE = 1024
FRAME_FILTERS = (256, 512, 512, 1024, 1024)
FRAME_KERNEL = 3


class WaveformTrunk(nn.Module):
    """Nine dilated convolutions without padding: maps (B, N, T), T above 15,000, to (B, 1024)."""

    def __init__(self, num_microphones: int, width: float) -> None:
        super().__init__()
        layers, inputs = nn.Sequential(), num_microphones
        stages = zip(FILTERS, KERNELS, DILATIONS, strict=True)
        for number, (filters, kernel, dilation) in enumerate(stages, start=1):
            outputs = scaled(filters, width)
            layers.append(_layer(inputs, outputs, kernel, dilation))
            if number in POOLINGS:
                layers.append(nn.MaxPool1d(POOLINGS[number]))
            inputs = outputs
        self.layers = layers
        self.summary = _summary(inputs, scaled(DENSE, width))
        self.outputs = scaled(DENSE, width)

    def forward(self, audio: Tensor) -> Tensor:
        embedding: Tensor = self.summary(self.layers(audio).amax(-1))
        return embedding


class DoanetTrunk(nn.Module):
    """The trunk of the matched track: maps (B, 2N, 257, 64) to (B, 1024).

    All bins of all microphones are a frame's channels: the STFT replaces the filter bank of the
    first layers. Five dilated convolutions over the frames follow, with the publication's first
    five dilations; they are padded, since its kernels and dilations span more steps than there are
    frames. The publication's global maximum and dense layer come last.
    """

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        layers, inputs = nn.Sequential(), 2 * num_microphones * 257
        for filters, dilation in zip(FRAME_FILTERS, DILATIONS, strict=False):
            outputs = scaled(filters, width)
            layers.append(_layer(inputs, outputs, FRAME_KERNEL, dilation, padding=dilation))
            inputs = outputs
        self.layers = layers
        self.summary = _summary(inputs, scaled(DENSE, width))
        self.outputs = scaled(DENSE, width)

    def forward(self, features: Tensor) -> Tensor:
        embedding: Tensor = self.summary(self.layers(features.flatten(1, 2)).amax(-1))
        return embedding


def _layer(
    inputs: int, outputs: int, kernel: int, dilation: int, padding: int = 0
) -> nn.Sequential:
    """The publication normalises after the nonlinearity."""
    convolution = nn.Conv1d(inputs, outputs, kernel, padding=padding, dilation=dilation)
    return nn.Sequential(convolution, nn.ReLU(), nn.BatchNorm1d(outputs))


def _summary(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Dropout(0.5), nn.Linear(inputs, outputs), nn.ReLU(), nn.BatchNorm1d(outputs)
    )


class Doanet(BaselineNetwork):
    """DOANet as cited: raw audio to cosine and sine, 67.9 M parameters."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        self.trunk = WaveformTrunk(num_microphones, width)
        self.head = DirectionHead(self.trunk.outputs)

    def features(self, audio: FloatArray) -> FloatArray:
        """Audio (B, N, T) of unit power over all microphones."""
        power = np.mean(audio**2, axis=(-2, -1), keepdims=True)
        unit: FloatArray = (audio / np.sqrt(power + 1e-12)).astype(np.float32, copy=False)
        return unit

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        with training_precision(features, training=self.training):
            embedding = self.trunk(features)
        prediction = self.head(embedding.float())
        return replace(prediction, vectors=tuple(xy.tanh() for xy in prediction.vectors))
