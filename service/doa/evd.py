"""Eigenvalue decomposition (EVD) of spatial covariances: signal and noise subspace.

Conventions
-----------
Eigenvalues ascend, as LAPACK gives them. The signal subspace Us holds the eigenvectors of the M
largest eigenvalues, and the noise projector is I - Us Us^H, so the noise eigenvectors are never
needed.
"""

from __future__ import annotations

import numpy as np

from neuralmusic.errors import TooManySources
from service.doa.covariance import MOST_PLANES
from service.doa.types import ComplexArray, FloatArray

SQUARINGS = 3
APPLICATIONS = 3
"""Times that R^8 multiplies one of its columns, which gives R^32's: a vector costs a quarter or
less of a matrix"""


def signal_subspace(covariance: ComplexArray, num_sources: int) -> ComplexArray:
    """Eigenvectors of the ``num_sources`` largest eigenvalues.

    Parameters
    ----------
    covariance : (..., N, N) complex64
        Hermitian.
    num_sources : int
        1 to N - 1.

    Returns
    -------
    subspace : (..., N, M) complex64
        Orthonormal columns.

    Raises
    ------
    TooManySources
        If ``num_sources`` is not between 1 and N - 1.
    """
    check_dimension(num_sources, covariance.shape[-1])
    _, vectors = np.linalg.eigh(covariance)
    subspace: ComplexArray = vectors[..., -num_sources:]
    return subspace


def check_dimension(num_sources: int, microphones: int) -> None:
    """Raise TooManySources unless the signal subspace leaves a noise subspace."""
    if not 1 <= num_sources < microphones:
        raise TooManySources(
            f"num_sources is {num_sources}, but {microphones} microphones can tell apart 1 to "
            f"{microphones - 1} sources"
        )


def principal_eigenvector(covariance: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """The eigenvector of the largest eigenvalue and that eigenvalue's share of the trace.

    Repeated squaring: the columns of R^(2^k) converge to the principal eigenvector as
    (l2 / l1)^(2^k). This takes a tenth of LAPACK's time (docs/performance.md) and is exact to 1e-3
    where l2 < 0.8 l1; where two eigenvalues are closer, the result is some vector of their plane.

    Parameters
    ----------
    covariance : (..., N, N) complex64
        Hermitian, positive semidefinite.

    Returns
    -------
    vector : (..., N) complex64
        Unit norm.
    share : (...) float32
        Between 1 / N and 1; 0 for a zero matrix.
    """
    # Matrices first, (N, N, C): numpy's moveaxis costs more than the arithmetic of small arrays.
    shape, microphones = covariance.shape[:-2], covariance.shape[-1]
    axes = range(covariance.ndim - 2)
    planes = covariance.transpose(-2, -1, *axes)
    product = _matrix_product
    if microphones <= MOST_PLANES:
        planes, product = np.ascontiguousarray(planes), planes_product
    planes = planes.reshape(microphones, microphones, -1)
    trace = trace_of(planes)
    power = planes * (1 / trace)  # dividing a complex array by a real one would be slow
    for _ in range(SQUARINGS):
        power = product(power, power)
    # A trace of one keeps float32 from over- and underflow.
    power *= 1 / trace_of(power)
    largest = np.argmax(np.einsum("iic->ic", power).real, axis=0)
    column = power[:, largest, np.arange(len(largest))][:, None]
    for _ in range(APPLICATIONS):
        column = product(power, column)
    column = column[:, 0]
    vector = column * (1 / _norm(column))
    image = product(planes, vector[:, None])[:, 0]
    value = np.sum(vector.real * image.real + vector.imag * image.imag, axis=0)
    share: FloatArray = value / trace
    return vector.T.reshape(*shape, microphones), share.reshape(shape)


def planes_product(first: ComplexArray, second: ComplexArray) -> ComplexArray:
    """Matrix products of (N, N, ...) and (N, M, ...), entry by entry over all matrices at once."""
    product: ComplexArray = first[:, 0, None] * second[None, 0]
    for k in range(1, len(first)):
        product += first[:, k, None] * second[None, k]
    return product


def _matrix_product(first: ComplexArray, second: ComplexArray) -> ComplexArray:
    """``planes_product`` by BLAS, matrix by matrix."""
    matrices, others = (np.moveaxis(each, (0, 1), (-2, -1)) for each in (first, second))
    return np.moveaxis(matrices @ others, (-2, -1), (0, 1))


def _norm(vectors: ComplexArray) -> FloatArray:
    """Euclidean norms (...) of vectors (N, ...), at least the smallest float32."""
    squares = np.sum(vectors.real**2 + vectors.imag**2, axis=0)
    norm: FloatArray = np.maximum(np.sqrt(squares), np.finfo(np.float32).tiny)
    return norm


def trace_of(matrices: ComplexArray) -> FloatArray:
    """Traces (...) of Hermitian matrices (N, N, ...), at least the smallest float32."""
    trace: FloatArray = np.einsum("ii...->...", matrices).real
    return np.maximum(trace, np.finfo(np.float32).tiny)


def noise_projector(subspace: ComplexArray) -> ComplexArray:
    """I - Us Us^H of (..., N, M) orthonormal columns: (..., N, N) complex64."""
    projector: ComplexArray = np.eye(subspace.shape[-2], dtype=subspace.dtype) - subspace @ np.conj(
        np.swapaxes(subspace, -1, -2)
    )
    return projector
