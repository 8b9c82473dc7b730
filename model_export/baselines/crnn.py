"""CRNN: convolutions over mel levels and GCC-PHAT, then a bidirectional GRU (AFPILD-CRNN)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from model_export.baselines.features import framed_spectra, gcc_phat, log_mel, mel_filters
from model_export.baselines.heads import DirectionHead
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork, Prediction, scaled
from model_export.training.precision import training_precision
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

CARD = Card(
    "crnn",
    "CRNN",
    "learned",
    "Wu et al., AFPILD, Information Fusion 104 (2024)",
    "x and y per source in place of azimuth / 180; all frames of the window, not 64; no mixup",
)
NUM_MELS = 64
LAGS = np.arange(-NUM_MELS / 2, NUM_MELS / 2)
"""Lags in samples, as many as mel bands, so that both are channels of one map"""
WINDOW, HOP, N_FFT = 320, 160, 2048
"""Samples of a window (20 ms), a hop (10 ms) and a transform"""
CHANNELS = (32, 64, 128)
HIDDEN = 128
DROPOUT = 0.05

Pooling = tuple[int, int]


class RecurrentTrunk(nn.Module):
    """Three convolution blocks and two BiGRU layers: maps (B, C, H, W), W being time, to (B, D).

    The output is the product of both directions at the last step, as in the publication.
    ``poolings`` are the blocks' poolings over height and time.
    """

    def __init__(
        self, inputs: int, height: int, poolings: tuple[Pooling, ...], width: float
    ) -> None:
        super().__init__()
        blocks = nn.Sequential()
        for channels, pooling in zip(CHANNELS, poolings, strict=True):
            blocks.append(_block(inputs, scaled(channels, width), pooling))
            inputs, height = scaled(channels, width), height // pooling[0]
        self.blocks = blocks
        hidden = scaled(HIDDEN, width)
        self.recurrent = nn.GRU(inputs * height, hidden, 2, batch_first=True, bidirectional=True)
        self.dense = nn.Linear(hidden, hidden)
        self.outputs = hidden

    def forward(self, features: Tensor) -> Tensor:
        blocks = self.blocks(features).flatten(1, 2).mT  # (B, W', C' H')
        # bfloat16 makes the recurrence's small products no faster and loses digits over the steps.
        with torch.autocast(features.device.type, enabled=False):
            steps, _ = self.recurrent(blocks.float())  # (B, W', 2 D)
            onward, backward = steps[:, -1].chunk(2, -1)
            embedding: Tensor = torch.relu(self.dense(onward * backward))
        return embedding


def _block(inputs: int, outputs: int, pooling: Pooling) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
        nn.MaxPool2d(pooling),
        nn.Dropout(DROPOUT),
    )


class CrnnTrunk(RecurrentTrunk):
    """The trunk of the matched track: maps (B, 2N, 257, 64) to (B, 128).

    Bins are pooled four times more than mel bands, so that the GRU has 8 x 128 inputs and 16 steps,
    as in the publication.
    """

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__(2 * num_microphones, 257, ((4, 2), (4, 2), (2, 1)), width)


class Crnn(BaselineNetwork):
    """CRNN as cited: N mel levels, P correlations of 64 values each; 1.3 M parameters."""

    card = CARD

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        maps = num_microphones * (num_microphones + 1) // 2
        # Stands for the publication's z-scores over the training data.
        self.scale = nn.BatchNorm2d(maps, affine=False)
        self.trunk = RecurrentTrunk(maps, NUM_MELS, ((2, 2), (2, 2), (2, 1)), width)
        self.head = DirectionHead(self.trunk.outputs)

    def features(self, audio: FloatArray) -> FloatArray:
        """Features (B, N + P, 64, L): mel levels, then correlations at 64 lags."""
        spectra = framed_spectra(audio, WINDOW, HOP, N_FFT)
        levels = log_mel(spectra, mel_filters(NUM_MELS, N_FFT))
        maps = np.concatenate([levels, gcc_phat(spectra, LAGS)], axis=1)
        return np.ascontiguousarray(maps.swapaxes(-1, -2))

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        with training_precision(features, training=self.training):
            maps = self.scale(features).contiguous(memory_format=torch.channels_last)
            embedding = self.trunk(maps)
        prediction: Prediction = self.head(embedding)
        return prediction
