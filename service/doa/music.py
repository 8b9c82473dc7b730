"""The MUSIC pseudo-spectrum of signal subspaces.

With ||a||^2 = N the denominator a^H (I - Us Us^H) a is N - ||Us^H a||^2.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray

DENOMINATOR_FLOOR = 2e-7  # of N: float32 cannot tell smaller distances to the subspace from zero


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
    # Square in place: the response is megabytes, and fresh memory costs more than arithmetic.
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
    """``music_spectrum`` from the output of ``signal_power``, in place."""
    # In place: fresh memory costs more than arithmetic.
    np.subtract(1, power, out=power)
    np.maximum(power, 0, out=power)
    power += np.float32(floor)
    return np.divide(1, power, out=power)
