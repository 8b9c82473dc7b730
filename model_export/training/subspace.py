"""Differentiable subspaces in torch: the signal projector with its own gradient.

Eigenvectors have no derivative where eigenvalues coincide, but the projector onto the signal
subspace depends only on the gap between signal and noise eigenvalues. Differentiating the projector
itself is exact and stays finite inside degenerate subspaces, where torch.linalg.eigh's gradient is
wrong.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

RELATIVE_GAP_FLOOR = 1e-6
"""Least gap relative to the largest eigenvalue magnitude; below it the subspace is arbitrary"""


class _SignalProjector(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, covariance: Tensor, num_sources: int) -> Tensor:
        values, vectors = torch.linalg.eigh(covariance)
        signal = vectors[..., -num_sources:]
        ctx.save_for_backward(values, vectors)
        ctx.num_sources = num_sources
        return signal @ signal.mH

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        values, vectors = ctx.saved_tensors
        split = values.shape[-1] - ctx.num_sources
        noise, signal = vectors[..., :split], vectors[..., split:]
        gradient = 0.5 * (grads[0] + grads[0].mH)
        gap = values[..., None, split:] - values[..., :split, None]  # (..., N-M, M)
        floor = RELATIVE_GAP_FLOOR * values.abs().amax(-1)[..., None, None]
        coupling = (noise.mH @ gradient @ signal) / gap.clamp(min=floor.clamp(min=1e-30))
        half = noise @ coupling @ signal.mH
        return half + half.mH, None


def signal_projector(covariance: Tensor, num_sources: int) -> Tensor:
    """Projector Us Us^H onto the eigenvectors of the ``num_sources`` largest eigenvalues.

    Parameters
    ----------
    covariance : (..., N, N) complex
        Hermitian matrices R.
        num_sources : int
            Dimension of the signal subspace, 1 to N - 1.

    Returns
    -------
    projector : (..., N, N) complex
        Its gradient with respect to R, for an upstream Hermitian G, is
        Un [(Un^H G Us) / (lambda_s - lambda_n)] Us^H plus its conjugate transpose.
    """
    projector: Tensor = _SignalProjector.apply(covariance, num_sources)
    return projector


def dominance(covariance: Tensor, projector: Tensor) -> Tensor:
    """Share of the power in the signal subspace, scaled so that an isotropic field gives 0.

    Returns (...,) real: (tr(Ps R) / tr(R) - 1/N) / (1 - 1/N) for a projector of rank one.
    """
    microphones = covariance.shape[-1]
    captured = (projector * covariance.transpose(-1, -2)).sum((-2, -1)).real
    total = covariance.diagonal(dim1=-2, dim2=-1).real.sum(-1).clamp(min=1e-20)
    return ((captured / total) - 1 / microphones) / (1 - 1 / microphones)


def delay_products(delays: Tensor, frequencies: Tensor) -> Tensor:
    """Real columns that turn quadratic forms a^H R a into one real matrix product.

    Parameters
    ----------
    delays : (B, N, A) seconds
        Advances of the microphones over the array's centre, for every direction.
    frequencies : (F,) hertz

    Returns
    -------
    products : (B, F, N^2, A) real
        For steering vectors a: |a_n|^2 = 1, then 2 Re and 2 Im of conj(a_i) a_j for i < j.
    """
    microphones = delays.shape[-2]
    first, second = torch.triu_indices(microphones, microphones, 1)
    difference = delays[:, second] - delays[:, first]  # (B, pairs, A)
    phase = 2 * torch.pi * frequencies[:, None, None] * difference[:, None]
    powers = torch.ones_like(phase[:, :, :1]).expand(-1, -1, microphones, -1)
    return torch.cat([powers, 2 * torch.cos(phase), -2 * torch.sin(phase)], dim=-2)


def hermitian_rows(matrix: Tensor) -> Tensor:
    """The N^2 real numbers of a Hermitian (..., N, N) in the order of ``delay_products``."""
    first, second = torch.triu_indices(matrix.shape[-1], matrix.shape[-1], 1)
    upper = matrix[..., first, second]
    return torch.cat([matrix.diagonal(dim1=-2, dim2=-1).real, upper.real, upper.imag], dim=-1)


def signal_power(projector: Tensor, products: Tensor) -> Tensor:
    """Signal power a^H Ps a / N for every steering vector.

    Parameters
    ----------
    projector : (..., F, K, N, N) complex
        K matrices that share the bin's steering vectors.
    products : (..., F, N^2, A) real
        Products from ``delay_products``.

        Returns
    -------
    power : (..., F, K, A) real
        Values between 0 and 1.
    """
    return hermitian_rows(projector) @ products / projector.shape[-1]
