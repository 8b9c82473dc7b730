"""MUSIC spectra of single eigenvectors: many cells of a band on one grid of azimuths.

With one signal dimension and ||a||^2 = N the pseudo-spectrum is 1 / (1 - |u^H a|^2 / N + floor).
Divided by its maximum over the azimuths it is d_min / d with the distance
d = 1 + floor - |u^H a|^2 / N, so one division per value is enough.
"""

from __future__ import annotations

from weakref import WeakValueDictionary

import numpy as np

from service.doa.music import eigenvector_power
from service.doa.pair_products import pair_products
from service.doa.steering import azimuth_grid, steering_vectors
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
        # 1 + floor - |u^H a|^2 / N is that of the matrix -u u^H with another trace.
        self._trace = steering.shape[1] * (1 + floor) - 1
        self._products = pair_products(steering)
        self._steering = None if self._products else steering

    def spectra(self, vectors: ComplexArray) -> FloatArray:
        """Spectra (F, K, A) float32, each with maximum 1, of unit vectors (K, F, N)."""
        if self._products is not None:
            pairs = self._products.outer(vectors.transpose(2, 0, 1))
            distance = self._products.power(self._trace, np.negative(pairs, out=pairs))
        else:
            assert self._steering is not None
            by_bin = np.ascontiguousarray(vectors.transpose(1, 2, 0))
            distance = eigenvector_power(by_bin, self._steering)
            np.subtract(1 + self._floor, distance, out=distance)
        np.divide(distance.min(axis=-1, keepdims=True), distance, out=distance)
        return distance


_shared: WeakValueDictionary[tuple[bytes, bytes, int, float], RankOneMusic] = WeakValueDictionary()


def shared_music(
    positions: FloatArray, frequencies: FloatArray, grid_size: int, floor: float
) -> RankOneMusic:
    """The spectra of an array (N, 3) on ``azimuth_grid(grid_size)``.

    Users of the same array share one instance, which takes a megabyte or more.
    """
    key = (positions.tobytes(), frequencies.tobytes(), grid_size, floor)
    music = _shared.get(key)
    if music is None:
        steering = steering_vectors(positions, frequencies, azimuth_grid(grid_size))
        music = _shared[key] = RankOneMusic(steering, floor)
    return music
