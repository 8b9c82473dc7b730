"""The paper's networks, as its text has them: encoder, covariance regressor, count branch, FAF.

Shapes for N microphones, F = 257 bins and L = 64 frames. What leaves ``CovarianceNetwork`` and
``SourceCountNetwork`` is real, so that both export to ONNX; EVD and MUSIC stand between them and
``FrequencyAttentionFusion`` (``model_export.training.regression``).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from service.inference.results import MAX_SOURCES

NUM_BINS = 257
NUM_FRAMES = 64
LATENT = 64
"""D, covariance features per bin: what four poolings leave of 257 x 64 cells, 16 x 4"""
DIAGONAL_LOADING = 1e-5


def conv_block(inputs: int, outputs: int) -> nn.Sequential:
    """(B, inputs, H, W) -> (B, outputs, H // 2, W // 2)."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.BatchNorm2d(outputs),
        # A maximum and a ReLU commute; in this order the ReLU meets a quarter of the cells.
        nn.MaxPool2d(2),
        nn.ReLU(),
    )


class Encoder(nn.Sequential):
    """Features to latent covariance features, one channel of the last block per frequency bin.

    The last block's channel f stands for bin f: the frequency axis of the input is pooled sixteen
    times, and only training pairs the channels with the bins' steering vectors. It is a module of
    its own so that pretrained weights can be loaded into it.
    """

    def __init__(self, num_microphones: int) -> None:
        super().__init__(
            conv_block(2 * num_microphones, 64),  # (B, 2N, 257, 64) -> (B, 64, 128, 32)
            conv_block(64, 64),  # (B, 64, 64, 16)
            conv_block(64, 64),  # (B, 64, 32, 8)
            conv_block(64, NUM_BINS),  # (B, 257, 16, 4)
            nn.Flatten(2),  # (B, 257, 64)
        )


class CovarianceRegressor(nn.Module):
    """One linear map, shared by all bins, from latent features to a Hermitian matrix."""

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.num_microphones = num_microphones
        self.linear = nn.Linear(LATENT, 2 * num_microphones**2)
        self.register_buffer(
            "loading", DIAGONAL_LOADING * torch.eye(num_microphones), persistent=False
        )

    def forward(self, latent: Tensor) -> Tensor:
        size = self.num_microphones
        matrix = self.linear(latent).unflatten(-1, (size, 2 * size))  # (B, F, N, 2N)
        real, imaginary = matrix[..., :size], matrix[..., size:]  # (B, F, N, N) each
        # (R + R^H) / 2 in real numbers: the real part is symmetric, the imaginary part is not.
        real = 0.5 * (real + real.mT) + self.loading
        imaginary = 0.5 * (imaginary - imaginary.mT)
        return torch.stack([real, imaginary], dim=2)  # (B, F, 2, N, N)


class CovarianceNetwork(nn.Module):
    """Features (B, 2N, 257, 64) to real and imaginary parts (B, 257, 2, N, N) of R_hat(f)."""

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.encoder = Encoder(num_microphones)
        self.regressor = CovarianceRegressor(num_microphones)

    def forward(self, features: Tensor) -> Tensor:
        latent = self.encoder(features)  # (B, 257, 64)
        covariance: Tensor = self.regressor(latent)  # (B, 257, 2, N, N)
        return covariance


class SourceCountNetwork(nn.Module):
    """The parallel branch: features (B, 2N, 257, 64) to logits of 0 to M_max sources (B, 5)."""

    def __init__(self, num_microphones: int, max_sources: int = MAX_SOURCES) -> None:
        super().__init__()
        self.blocks = nn.Sequential(
            conv_block(2 * num_microphones, 16),  # (B, 16, 128, 32)
            conv_block(16, 16),  # (B, 16, 64, 16)
            conv_block(16, 16),  # (B, 16, 32, 8)
            conv_block(16, 32),  # (B, 32, 16, 4)
        )
        self.classifier = nn.Sequential(
            nn.Flatten(),  # (B, 2048)
            nn.Linear(32 * LATENT, 128),  # (B, 128)
            nn.LeakyReLU(0.1),
            nn.Linear(128, max_sources + 1),  # (B, 5)
        )

    def forward(self, features: Tensor) -> Tensor:
        logits: Tensor = self.classifier(self.blocks(features))
        return logits


class FrequencyAttentionFusion(nn.Module):
    """FAF: P(theta) = sum_f alpha_f P(f, theta) / sum_f alpha_f.

    alpha = sigmoid(W2 ReLU(W1 GAP(P))), GAP being the mean over the angles. The paper's sum is not
    divided; divided, the fused spectrum is a convex combination and stays within [0, 1], which its
    target does too. No weight belongs to an angle, so a rotated spectrum fuses to a rotated one.
    """

    def __init__(self, num_bins: int = NUM_BINS, bottleneck: int = 16) -> None:
        super().__init__()
        self.squeeze = nn.Linear(num_bins, bottleneck, bias=False)
        self.excite = nn.Linear(bottleneck, num_bins, bias=False)

    def attention(self, spectrum: Tensor) -> Tensor:
        """Weights (B, F) in (0, 1) of the spectra (B, F, A)."""
        pooled = spectrum.mean(-1)  # (B, F)
        hidden = torch.relu(self.squeeze(pooled))  # (B, 16)
        return torch.sigmoid(self.excite(hidden))  # (B, F)

    def forward(self, spectrum: Tensor) -> Tensor:
        alpha = self.attention(spectrum)  # (B, F)
        fused = torch.einsum("bf,bfa->ba", alpha, spectrum)  # (B, A)
        return fused / alpha.sum(-1, keepdim=True)
