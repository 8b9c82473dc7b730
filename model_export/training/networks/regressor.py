"""The covariance regressor: latent features to Hermitian matrices."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.training.networks import LATENT
from model_export.training.networks.encoder import Encoder

DIAGONAL_LOADING = 1e-5


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
        # (R + R^H) / 2 in real numbers: a symmetric real part and an antisymmetric imaginary part.
        real = 0.5 * (real + real.mT) + self.loading
        imaginary = 0.5 * (imaginary - imaginary.mT)
        return torch.stack([real, imaginary], dim=2)  # (B, F, 2, N, N)


class CovarianceNetwork(nn.Module):
    """Maps features (B, 2N, 257, 64) to real and imaginary parts (B, 257, 2, N, N) of R_hat(f)."""

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.encoder = Encoder(num_microphones)
        self.regressor = CovarianceRegressor(num_microphones)

    def forward(self, features: Tensor) -> Tensor:
        latent = self.encoder(features)  # (B, 257, 64)
        covariance: Tensor = self.regressor(latent)  # (B, 257, 2, N, N)
        return covariance
