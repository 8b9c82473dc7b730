"""Subspaces of the spatial covariance and the MUSIC pseudo-spectrum.

Conventions
-----------
Eigenvalues ascend, as LAPACK gives them. The signal subspace Us holds the eigenvectors of the M
largest eigenvalues and the noise projector is I - Us Us^H. With ||a||^2 = N the MUSIC denominator
is a^H (I - Us Us^H) a = N - ||Us^H a||^2, so the noise eigenvectors are never needed.
"""

from __future__ import annotations

import numpy as np

from service.doa.covariance import MOST_PLANES
from service.doa.types import ComplexArray, FloatArray
from service.errors import TooManySources

SQUARINGS = 3
APPLICATIONS = 3
"""Of R^8 to a column of it, which is R^32's then: a vector costs a quarter or less of a matrix"""
DENOMINATOR_FLOOR = 2e-7  # of N: float32 cannot tell smaller distances to the subspace from zero


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

    By squaring: the columns of R^(2^k) turn to the principal eigenvector as (l2 / l1)^(2^k). It
    takes a tenth of LAPACK's time (docs/performance.md) and is exact to 1e-3 where l2 < 0.8 l1;
    where two eigenvalues are closer, it is some vector of their plane.

    Parameters
    ----------
    covariance : (..., N, N) complex64
        Hermitian, positive semidefinite.

    Returns
    -------
    vector : (..., N) complex64
        Unit norm.
    share : (...) float32
        Between 1 / N and 1; 0 of a zero matrix.
    """
    # Matrices first, (N, N, C): numpy's moveaxis costs more than small arrays' arithmetic.
    shape, microphones = covariance.shape[:-2], covariance.shape[-1]
    axes = range(covariance.ndim - 2)
    planes = covariance.transpose(-2, -1, *axes)
    product = _matrix_product
    if microphones <= MOST_PLANES:
        planes, product = np.ascontiguousarray(planes), planes_product
    planes = planes.reshape(microphones, microphones, -1)
    trace = trace_of(planes)
    power = planes * (1 / trace)  # multiplied: a complex array by a real one divides slowly
    for _ in range(SQUARINGS):
        power = product(power, power)
    # The trace is made one again, so that float32 neither over- nor underflows.
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
    """The same by BLAS, matrix by matrix."""
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


def eigenvector_power(vectors: ComplexArray, steering: ComplexArray) -> FloatArray:
    """|u^H a|^2 / N of every eigenvector u and steering vector a.

    Parameters
    ----------
    vectors : (..., F, N, K) complex64
        Unit columns; the eigenvectors of one matrix, or the principal ones of K matrices.
    steering : (F, N, A) complex64

    Returns
    -------
    power : (..., F, K, A) float32
        Between 0 and 1.
    """
    scaled = np.conj(np.swapaxes(vectors, -1, -2)) * np.float32(steering.shape[-2] ** -0.5)
    response = scaled @ steering
    # Squared in place: the response is megabytes, and fresh memory costs more than arithmetic.
    parts = response.view(response.real.dtype)
    np.square(parts, out=parts)
    power: FloatArray = parts[..., 0::2] + parts[..., 1::2]
    return power


def signal_power(subspace: ComplexArray, steering: ComplexArray) -> FloatArray:
    """||Us^H a||^2 / N for every steering vector: 1 where a lies in the signal subspace.

    ``subspace`` (..., F, N, M) with orthonormal columns and ``steering`` (F, N, A) give
    (..., F, A) float32 between 0 and 1.
    """
    power: FloatArray = eigenvector_power(subspace, steering).sum(axis=-2)
    return power


def music_spectrum(
    subspace: ComplexArray, steering: ComplexArray, floor: float = DENOMINATOR_FLOOR
) -> FloatArray:
    """MUSIC pseudo-spectrum per frequency bin, 1 / (1 - ||Us^H a||^2 / N + floor).

    Parameters
    ----------
    subspace : (..., F, N, M) complex64
    steering : (F, N, A) complex64
    floor : float
        Keeps the spectrum finite where a lies in the signal subspace; a larger one broadens peaks.

    Returns
    -------
    spectrum : (..., F, A) float32
        Scaled by N against the textbook form, so that it does not grow with the array.

    References
    ----------
    Schmidt, 1986, Multiple emitter location and signal parameter estimation, eq. (6).
    """
    return spectrum_of_power(signal_power(subspace, steering), floor)


def spectrum_of_power(power: FloatArray, floor: float = DENOMINATOR_FLOOR) -> FloatArray:
    """``music_spectrum`` of what ``signal_power`` gives, in its place."""
    # Fresh memory costs more than arithmetic.
    np.subtract(1, power, out=power)
    np.maximum(power, 0, out=power)
    power += np.float32(floor)
    return np.divide(1, power, out=power)
