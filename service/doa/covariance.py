"""Spatial covariance: R(f) = E[x x^H], one Hermitian N x N matrix per frequency bin."""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray


def sample_covariance(spectra: ComplexArray) -> ComplexArray:
    """Average of x x^H over frames.

    Parameters
    ----------
    spectra : (..., N, F, L) complex64

    Returns
    -------
    covariance : (..., F, N, N) complex64
    """
    by_bin = np.swapaxes(spectra, -3, -2)  # (..., F, N, L)
    covariance: ComplexArray = by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
    return covariance / np.float32(spectra.shape[-1])


def weighted_covariance(
    spectra: ComplexArray, weights: FloatArray, block_frames: int
) -> ComplexArray:
    """Weighted covariances of consecutive blocks of frames.

    R(f, b) = sum over the frames l of block b of w(f, l) x x^H, with x scaled to unit norm, so that
    the weights alone decide what counts (the normalised time-frequency weights of arXiv
    2302.10147).

    Parameters
    ----------
    spectra : (..., N, F, L) complex64
        L a multiple of ``block_frames``.
    weights : (..., F, L) float32
        Non-negative.
    block_frames : int
        Frames per block.

    Returns
    -------
    covariance : (..., F, L / block_frames, N, N) complex64
    """
    *batch, microphones, bins, frames = spectra.shape
    power = np.sum(spectra.real**2 + spectra.imag**2, axis=-3)  # (..., F, L)
    scale = np.sqrt(weights / np.maximum(power, np.finfo(np.float32).tiny))
    scaled = np.moveaxis(spectra * scale[..., None, :, :], -3, -2)  # (..., F, N, L)
    blocks = scaled.reshape(*batch, bins, microphones, frames // block_frames, block_frames)
    blocks = np.moveaxis(blocks, -2, -3)  # (..., F, blocks, N, block_frames)
    covariance: ComplexArray = blocks @ np.conj(np.swapaxes(blocks, -1, -2))
    return covariance


def diagonal_loading(covariance: ComplexArray, loading: float) -> ComplexArray:
    """R + loading I; it bounds the eigenvalues from below and leaves the eigenvectors alone."""
    loaded: ComplexArray = covariance + loading * np.eye(
        covariance.shape[-1], dtype=covariance.dtype
    )
    return loaded
