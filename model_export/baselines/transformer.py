"""Transformer: attention over spectrogram patches of every microphone, then over all (BAST)."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.baselines.features import framed_spectra, log_level, unit_phases
from model_export.baselines.heads import DirectionHead
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork, Prediction
from model_export.training.precision import training_precision
from service.doa.array import MicrophoneArray
from service.doa.features import LEVEL_SCALE
from service.doa.types import FloatArray

CARD = Card(
    "transformer",
    "Transformer",
    "learned",
    "Kuang et al., BAST, arXiv 2207.03927, shared encoders",
    "phases relative to microphone 1 beside levels, which say little without a head between the "
    "microphones; a learned sum over microphones in place of left less right; x and y per source",
)
WINDOW = 256
FRAMES = 61
PATCH, STRIDE = 16, 6
NUM_PATCHES = 180
"""Number of patches, 20 in frequency by 9 in time"""
PLANES = 3
"""Planes per microphone: level, cosine and sine of its relative phase"""
DEPTH = 3
HEADS, HEAD_SIZE = 16, 64
DROPOUT = 0.2


class PatchEmbedding(nn.Module):
    """Embeds overlapping patches of (B, C, H, W) as tokens (B, 1 + 180, D), the class token first.

    ``scale`` widens patches and strides in frequency; the map is padded with zeros.
    """

    def __init__(self, planes: int, size: int, scale: int = 1) -> None:
        super().__init__()
        kernel, stride = (scale * PATCH, PATCH), (scale * STRIDE, STRIDE)
        self.padded = (scale * (PATCH + 19 * STRIDE), PATCH + 8 * STRIDE)
        self.linear = nn.Conv2d(planes, size, kernel, stride)
        self.first = nn.Parameter(torch.randn(1, 1, size))
        self.position = nn.Parameter(torch.randn(1, 1 + NUM_PATCHES, size))

    def forward(self, maps: Tensor) -> Tensor:
        height, width = maps.shape[-2:]
        maps = F.pad(maps, (0, self.padded[1] - width, 0, self.padded[0] - height))
        patches = self.linear(maps).flatten(2).mT  # (B, 180, D)
        tokens: Tensor = torch.cat([self.first.expand(len(patches), -1, -1), patches], 1)
        return tokens + self.position


def encoder(size: int, heads: int, depth: int) -> nn.TransformerEncoder:
    """Layers that normalise before attention and before the perceptron, which has the same width.

    Dropout applies to the layers' outputs only; on attention weights it would take half the time.
    """
    layer = nn.TransformerEncoderLayer(
        size, heads, size, DROPOUT, "gelu", batch_first=True, norm_first=True
    )
    layer.self_attn.dropout = 0.0
    return nn.TransformerEncoder(layer, depth, enable_nested_tensor=False)


class TransformerTrunk(nn.Module):
    """The trunk of the matched track: maps (B, 2N, 257, 64) to (B, 1024).

    It has one encoder, as deep as the publication's two in sequence: the features are already
    relative to one microphone, so the tokens are patches of all microphones together. A patch
    covers 32 bins, a kilohertz as in the publication, which gives its 180 patches.
    """

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        heads = max(1, round(HEADS * width))
        self.outputs = heads * HEAD_SIZE
        self.patches = PatchEmbedding(2 * num_microphones, self.outputs, scale=2)
        self.encoder = encoder(self.outputs, heads, 2 * DEPTH)
        self.norm = nn.LayerNorm(self.outputs)

    def forward(self, features: Tensor) -> Tensor:
        embedding: Tensor = self.norm(self.encoder(self.patches(features)).mean(1))
        return embedding


class Transformer(BaselineNetwork):
    """BAST as cited: one encoder for each microphone, one for all; 38.2 M parameters for two ears.

    ``width`` scales the number of heads of 64.
    """

    card = CARD
    learning_rate = 1e-4

    def __init__(self, num_microphones: int, *, width: float = 1.0) -> None:
        super().__init__()
        heads = max(1, round(HEADS * width))
        size = heads * HEAD_SIZE
        self.patches = PatchEmbedding(PLANES, size)
        self.encoder = encoder(size, heads, DEPTH)
        # For two microphones, the publication's difference and sum are special cases of this.
        self.mixture = nn.Parameter(torch.randn(num_microphones, size) / num_microphones**0.5)
        self.integration = encoder(size, heads, DEPTH)
        self.norm = nn.LayerNorm(size)
        self.head = DirectionHead(size)
        # Narrower layers get a higher rate: with Adam, outputs move by the width times the rate.
        self.learning_rate = 1e-4 * HEADS / heads  # type: ignore[misc]

    def features(self, audio: FloatArray) -> FloatArray:
        """Features (B, N, 3, 129, 61); the frames are spread over the whole window."""
        hop = (audio.shape[-1] - WINDOW) // (FRAMES - 1)
        spectra = framed_spectra(audio, WINDOW, hop, WINDOW)[..., :FRAMES, :]  # (B, N, L, F)
        level = np.float32(LEVEL_SCALE) * log_level(spectra.real**2 + spectra.imag**2)
        phase = unit_phases(spectra)
        phase = phase * phase[:, :1].conj()
        planes = np.stack([level, phase.real, phase.imag], axis=2)  # (B, N, 3, L, F)
        return np.ascontiguousarray(planes.swapaxes(-1, -2), dtype=np.float32)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        with training_precision(features, training=self.training):
            tokens = self.encoder(self.patches(features.flatten(0, 1)))
            each = tokens.unflatten(0, features.shape[:2])  # (B, N, 181, D)
            mixed = torch.einsum("bnpd,nd->bpd", each, self.mixture)
            embedding = self.norm(self.integration(mixed).mean(1))
        prediction: Prediction = self.head(embedding.float())
        return prediction
