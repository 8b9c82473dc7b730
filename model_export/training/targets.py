"""Target spectra on the circle and the losses against them."""

from __future__ import annotations

import torch
from torch import Tensor


def wrapped_gaussians(azimuth: Tensor, grid: Tensor, sigma: float) -> Tensor:
    """A wrapped Gaussian of unit height for every source.

    Parameters
    ----------
    azimuth : (..., M) radians
    grid : (A,) radians
    sigma : float
        Radians, small against pi, so that one wrap each way is exact.

    Returns
    -------
    bumps : (..., M, A)
    One spectrum per source.
    """
    difference = torch.remainder(grid - azimuth[..., None] + torch.pi, 2 * torch.pi) - torch.pi
    return torch.exp(-0.5 * (difference / sigma) ** 2)


def target_spectrum(azimuth: Tensor, mask: Tensor, grid: Tensor, sigma: float) -> Tensor:
    """Sum of the sources' wrapped Gaussians with a maximum of 1, or zeros without a source.

    ``azimuth`` (B, M) radians and ``mask`` (B, M) bool give (B, A); masked-out sources are ignored.
    """
    summed = (wrapped_gaussians(azimuth, grid, sigma) * mask[..., None]).sum(-2)
    return summed / summed.amax(-1, keepdim=True).clamp(min=1e-6)


def spectrum_cross_entropy(fused: Tensor, target: Tensor, sharpness: Tensor) -> Tensor:
    """Cross entropy between softmax(sharpness * fused) and the target scaled to sum to one.

    The loss is permutation-free: the target is one distribution over angles for any number of
    sources. ``fused`` and ``target`` are (B, A); scenes without a source are left out.
    """
    mass = target.sum(-1, keepdim=True)
    present = mass[:, 0] > 0
    if not present.any():
        return fused.sum() * 0.0
    distribution = target[present] / mass[present]
    return -(distribution * torch.log_softmax(sharpness * fused[present], -1)).sum(-1).mean()
