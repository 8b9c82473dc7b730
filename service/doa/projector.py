"""The projector on the signal subspace of small Hermitian matrices, without eigenvectors.

A projector on eigenvectors is a polynomial of the matrix that is 1 at the eigenvalues of the signal
and 0 at those of the noise. For up to four microphones the characteristic polynomial has at most
degree four and can be solved for all bins at once; LAPACK goes from bin to bin and takes three
times as long (docs/performance.md).
"""

from __future__ import annotations

import numpy as np

from service.doa.covariance import MOST_PLANES
from service.doa.evd import check_dimension, planes_product, signal_subspace, trace_of
from service.doa.types import ComplexArray, FloatArray

MOST_SOURCES = 2
"""Most sources for which the polynomial is used"""
NEWTON_STEPS = 2
MOST_RESIDUAL = 1e-5
"""Largest error of the traces of P and P^2, which should be the number of sources. Bins above it go
to LAPACK: their eigenvalues of signal and noise differ by some 1e-5 of the trace, or not at all"""
TINY = np.finfo(np.float64).tiny


def signal_projector(covariance: ComplexArray, num_sources: int) -> ComplexArray:
    """Us Us^H of the eigenvectors of the ``num_sources`` largest eigenvalues.

    Parameters
    ----------
    covariance : (F, N, N) complex64
        Hermitian, positive semidefinite, N at most ``MOST_PLANES``.
    num_sources : int
        1 to N - 1; up to ``MOST_SOURCES`` need no eigenvectors.

    Returns
    -------
    projector : (N, N, F) complex

    Raises
    ------
    TooManySources
        If ``num_sources`` is not between 1 and N - 1.
    """
    if num_sources > MOST_SOURCES:
        return _by_eigenvectors(covariance, num_sources)
    bins, microphones, _ = covariance.shape
    check_dimension(num_sources, microphones)
    # Padding with silent microphones adds eigenvalues of zero, after all others.
    matrices = np.zeros((MOST_PLANES, MOST_PLANES, bins), dtype=np.complex128)
    matrices[:microphones, :microphones] = covariance.transpose(1, 2, 0)
    matrices *= 1 / trace_of(matrices)
    _plus_diagonal(matrices, -1 / MOST_PLANES)
    with np.errstate(all="ignore"):  # bins without a gap are computed again below
        projector = _polynomial(matrices, num_sources)
        traces = np.array([trace_of(projector), _inner(projector, projector)])
        unclear = ~(np.abs(traces - num_sources).max(axis=0) < MOST_RESIDUAL)  # true for NaN, too
    projector = projector[:microphones, :microphones]
    if unclear.any():
        projector[:, :, unclear] = _by_eigenvectors(covariance[unclear], num_sources)
    return projector


def _by_eigenvectors(covariance: ComplexArray, num_sources: int) -> ComplexArray:
    subspace = signal_subspace(covariance, num_sources)
    projector: ComplexArray = subspace @ np.conj(np.swapaxes(subspace, -1, -2))
    return projector.transpose(1, 2, 0)


def _polynomial(matrix: ComplexArray, rank: int) -> ComplexArray:
    """The polynomial of traceless matrices (4, 4, F) that is 1 at their largest eigenvalues."""
    square = planes_product(matrix, matrix)
    # The characteristic polynomial x^4 + p x^2 + q x + r, by Newton's identities.
    second, third, fourth = _inner(matrix, matrix), _inner(matrix, square), _inner(square, square)
    p, q, r = second / -2, third / -3, (second * second / 2 - fourth) / 4
    slope, offset, s, u, constant = _one_root(p, q, r) if rank == 1 else _two_roots(p, q, r)
    square += s * matrix
    projector = planes_product(_plus_diagonal(slope * matrix, offset), _plus_diagonal(square, u))
    return _plus_diagonal(projector, constant)


def _two_roots(p: FloatArray, q: FloatArray, r: FloatArray) -> tuple[FloatArray, ...]:
    """Coefficients (F,) of (l x + m)(x^2 + s x + u) + v: 1 at the two largest roots, 0 at others.

    At the two largest, where x^2 is s x - t, the second factor is 2 s x + w.
    """
    s, t, u = _quadratics(p, q, r)
    twice, w = s + s, u - t
    sum_of_both = twice * s + w
    scale = 1 / (twice * twice * t + w * sum_of_both)
    return -twice * scale, sum_of_both * scale, s, u, np.zeros_like(s)


def _one_root(p: FloatArray, q: FloatArray, r: FloatArray) -> tuple[FloatArray, ...]:
    """The same for the largest root alone: the polynomial over x - root, scaled to 1 there."""
    s, t, _ = _quadratics(p, q, r)
    root = s / 2 + np.sqrt(np.maximum(s * s / 4 - t, 0))
    for _ in range(NEWTON_STEPS):  # where the other roots coincide, half of the digits are right
        square = root * root
        slope = (4 * square + 2 * p) * root + q
        root = root - (((square + p) * root + q) * root + r) / slope
    square = root * root
    scale = 1 / ((4 * square + 2 * p) * root + q)
    linear = square + p
    return scale, np.zeros_like(scale), root, linear, (linear * root + q) * scale


def _quadratics(p: FloatArray, q: FloatArray, r: FloatArray) -> tuple[FloatArray, ...]:
    """s, t, u of x^4 + p x^2 + q x + r = (x^2 - s x + t)(x^2 + s x + u), the larger roots first.

    s^2 is the largest root of the resolvent cubic z^3 + 2 p z^2 + (p^2 - 4 r) z - q^2 (Descartes).
    """
    square = p * p
    height = np.maximum(square / 9 + r * (4 / 3), TINY)
    radius = np.sqrt(height)
    cosine = (q * q + p * (square / 13.5 - r * (8 / 3))) / (2 * height * radius)
    angle = np.arccos(np.minimum(np.maximum(cosine, -1), 1)) / 3
    largest = np.maximum(2 * radius * np.cos(angle) - p / 1.5, TINY)
    s = np.sqrt(largest)
    total, difference = p + largest, q / s
    return s, (total + difference) / 2, (total - difference) / 2


def _inner(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Traces (F,) of the products of Hermitian matrices (N, N, F)."""
    parts = (first.view(np.float64) * second.view(np.float64)).sum(axis=(0, 1))
    traces: FloatArray = parts[0::2] + parts[1::2]
    return traces


def _plus_diagonal(matrices: ComplexArray, values: FloatArray | float) -> ComplexArray:
    """Add values to the diagonals of matrices (N, N, F), in place."""
    for entry in range(len(matrices)):
        matrices[entry, entry] += values
    return matrices
