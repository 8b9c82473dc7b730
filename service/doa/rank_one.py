"""MUSIC spectra of single eigenvectors: many cells of a band on one grid of azimuths.

With one signal dimension and ||a||^2 = N the pseudo-spectrum is 1 / (1 - |u^H a|^2 / N + floor).
Divided by its maximum over the azimuths it is d_min / d with the distance
d = 1 + floor - |u^H a|^2 / N, so that one division per value is enough.
"""

from __future__ import annotations

from weakref import WeakValueDictionary

import numpy as np

from service.doa.covariance import MOST_PLANES
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.subspace import eigenvector_power
from service.doa.types import ComplexArray, FloatArray


class RankOneMusic:
    """The spectra of one array's eigenvectors; safe to use from several threads.

    Parameters
    ----------
    steering : (F, N, A) complex64
    floor : float
        Width of the peaks.
    """

    def __init__(self, steering: ComplexArray, floor: float) -> None:
        self._floor = np.float32(floor)
        microphones = steering.shape[1]
        self._pairs = np.triu_indices(microphones, 1)
        pairs = len(self._pairs[0])
        self._opposite = np.repeat(np.array([1, -1], dtype=np.float32), [1 + pairs, pairs])
        """Signs of the coefficients of opposite azimuths"""
        self._steering: ComplexArray | None = None
        self._products: FloatArray | None = None
        delays_alone = np.allclose(np.abs(steering), 1, atol=1e-5)  # not whitened
        if microphones > MOST_PLANES or not (delays_alone and _in_opposite_pairs(steering)):
            self._steering = steering
        else:
            half = steering.shape[2] // 2
            self._products = self._distance_products(steering[..., :half])

    def _distance_products(self, steering: ComplexArray) -> FloatArray:
        """What ``_coefficients`` are multiplied with to give distances: (F, 1 + N (N - 1), A / 2).

        |u^H a|^2 = ||u||^2 + sum over pairs of 2 Re(u_i u_j^* a_i^* a_j), all |a_n| being one: for
        few microphones a real matrix product, less than the complex response and its square.
        """
        first, second = self._pairs
        microphones = steering.shape[1]
        pairs = np.conj(steering[:, first]) * steering[:, second] * (-2 / microphones)
        constant = np.full_like(steering[:, :1].real, 1 + self._floor - 1 / microphones)
        return np.concatenate([constant, pairs.real, -pairs.imag], axis=1, dtype=np.float32)

    def spectra(self, vectors: ComplexArray) -> FloatArray:
        """Spectra (F, K, A) float32, each with maximum 1, of unit vectors (K, F, N)."""
        if self._products is not None:
            halves = self._coefficients(vectors) @ self._products  # (F, 2 K, A / 2)
            distance: FloatArray = halves.reshape(len(halves), len(vectors), -1)
        else:
            assert self._steering is not None
            by_bin = np.ascontiguousarray(vectors.transpose(1, 2, 0))
            distance = eigenvector_power(by_bin, self._steering)
            np.subtract(1 + self._floor, distance, out=distance)
        np.divide(distance.min(axis=-1, keepdims=True), distance, out=distance)
        return distance

    def _coefficients(self, vectors: ComplexArray) -> FloatArray:
        """1 and real and imaginary parts of u_i u_j^* of all pairs: (F, 2 K, 1 + N (N - 1)).

        Two rows for every vector, the second for opposite azimuths: their products are the
        conjugates.
        """
        first, second = self._pairs
        planes = vectors.transpose(2, 0, 1)  # (N, K, F)
        pairs = planes[first] * np.conj(planes[second])
        number, count, bins = pairs.shape
        columns = np.empty((1 + 2 * number, count, bins), dtype=np.float32)
        columns[0] = 1
        columns[1 : 1 + number] = pairs.real
        columns[1 + number :] = pairs.imag
        rows = np.empty((bins, count, 2, len(columns)), dtype=np.float32)
        rows[:, :, 0] = columns.transpose(2, 1, 0)
        np.multiply(rows[:, :, 0], self._opposite, out=rows[:, :, 1])
        return rows.reshape(bins, 2 * count, -1)


def _in_opposite_pairs(steering: ComplexArray) -> bool:
    """Whether the second half of the azimuths is opposite the first: delays change their signs."""
    first, second = np.array_split(steering, 2, axis=2)
    return first.shape == second.shape and np.allclose(second, np.conj(first), atol=1e-4)


_shared: WeakValueDictionary[tuple[bytes, bytes, int, float], RankOneMusic] = WeakValueDictionary()


def shared_music(
    positions: FloatArray, frequencies: FloatArray, grid_size: int, floor: float
) -> RankOneMusic:
    """The spectra of an array (N, 3) on ``azimuth_grid(grid_size)``.

    The same instance for the same array as long as anybody has one: robots of one kind share it,
    a megabyte or more.
    """
    key = (positions.tobytes(), frequencies.tobytes(), grid_size, floor)
    music = _shared.get(key)
    if music is None:
        steering = steering_vectors(positions, frequencies, azimuth_grid(grid_size))
        music = _shared[key] = RankOneMusic(steering, floor)
    return music
