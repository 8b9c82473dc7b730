"""Spatial covariance: R(f) = E[x x^H], one Hermitian N x N matrix per frequency bin."""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray, IntArray

MOST_PLANES = 4
"""Most microphones for which small matrices cost less entry by entry, over all blocks and bins at
once, than in thousands of calls of BLAS"""


def sample_covariance(spectra: ComplexArray) -> ComplexArray:
    """Average of x x^H over frames.

    Parameters
    ----------
    spectra : (..., N, F, L) complex64

    Returns
    -------
    covariance : (..., F, N, N) complex64
    """
    # One copy here: the product would copy both of its operands.
    by_bin = np.ascontiguousarray(np.swapaxes(spectra, -3, -2))  # (..., F, N, L)
    covariance: ComplexArray = by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
    return covariance / np.float32(spectra.shape[-1])


def weighted_covariance(unit: ComplexArray, weights: FloatArray, block_frames: int) -> ComplexArray:
    """Weighted covariances of consecutive blocks of frames.

    R(b, f) = sum over the frames l of block b of w(f, l) x x^H, with x of unit norm, so that the
    weights alone decide what counts (the normalised time-frequency weights of arXiv 2302.10147).

    Parameters
    ----------
    unit : (N, F, L) complex64
        Channel vectors of unit norm, L a multiple of ``block_frames``.
    weights : (F, L) float32
        Non-negative.
    block_frames : int
        Frames per block.

    Returns
    -------
    covariance : (L / block_frames, F, N, N) complex64
        For up to ``MOST_PLANES`` microphones planes in memory: N x N arrays over blocks and bins.
    """
    microphones, bins, frames = unit.shape
    scaled = np.swapaxes(unit * np.sqrt(weights), 1, 2)  # (N, L, F), the STFT's order in memory
    blocks = scaled.reshape(microphones, frames // block_frames, block_frames, bins)
    if microphones > MOST_PLANES:
        by_bin = np.ascontiguousarray(blocks.transpose(1, 3, 0, 2))  # (K, F, N, block_frames)
        return by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
    conjugate = np.conj(blocks)
    planes = np.empty((microphones, microphones, len(blocks[0]), bins), dtype=np.complex64)
    for i in range(microphones):
        for j in range(i, microphones):
            np.add.reduce(blocks[i] * conjugate[j], axis=1, out=planes[i, j])
            if j > i:
                np.conjugate(planes[i, j], out=planes[j, i])
    return planes.transpose(2, 3, 0, 1)


def diagonal_loading(covariance: ComplexArray, loading: float) -> ComplexArray:
    """R + loading I, in place; bounds the eigenvalues from below and keeps the eigenvectors."""
    for microphone in range(covariance.shape[-1]):  # one by one, as they may be planes in memory
        covariance[..., microphone, microphone] += np.float32(loading)
    return covariance


def chosen_and_sum(blocks: ComplexArray, chosen: IntArray) -> ComplexArray:
    """Chosen blocks of every bin and, behind them, the sum of all.

    ``blocks`` (K, F, N, N) and the indices ``chosen`` (R, F) give (R + 1, F, N, N), with the memory
    order of ``weighted_covariance``.
    """
    count, bins = chosen.shape
    microphones = blocks.shape[-1]
    if microphones > MOST_PLANES:
        cells = np.empty((count + 1, bins, microphones, microphones), dtype=blocks.dtype)
        cells[:-1] = np.take_along_axis(blocks, chosen[..., None, None], axis=0)
        np.sum(blocks, axis=0, out=cells[-1])
        return cells
    planes = np.moveaxis(blocks, (-2, -1), (0, 1))  # (N, N, K, F)
    cells = np.empty((microphones, microphones, count + 1, bins), dtype=blocks.dtype)
    places = chosen * bins + np.arange(bins)
    flat = planes.reshape(microphones, microphones, -1)
    np.take(flat, places, axis=2, out=cells[:, :, :-1], mode="clip")
    np.sum(planes, axis=2, out=cells[:, :, -1])
    return cells.transpose(2, 3, 0, 1)
