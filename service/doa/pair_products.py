"""a^H P a of Hermitian matrices P and steering vectors of few microphones, as real products.

Where steering vectors are pure delays, |a_n| = 1, a^H P a = tr P + sum over pairs i < j of
2 Re(P_ij conj(a_i) a_j). For few microphones this costs less than complex responses and their
squares: the array's part is computed once, and a matrix gives a row of real coefficients.
"""

from __future__ import annotations

import numpy as np

from service.doa.covariance import MOST_PLANES
from service.doa.types import ComplexArray, FloatArray


class PairProducts:
    """The real products of one array's pairs of microphones; see ``pair_products``.

    Parameters
    ----------
    steering : (F, N, A) complex64
        Entries of modulus 1. Where the second half of the azimuths is opposite the first, delays
        change their signs and the products are the conjugates: the first half is enough.
    """

    def __init__(self, steering: ComplexArray) -> None:
        _, microphones, self._azimuths = steering.shape
        self._first, self._second = np.triu_indices(microphones, 1)
        number = len(self._first)
        halves = 1 + _in_opposite_pairs(steering)
        steering = steering[..., : self._azimuths // halves]
        pairs = np.conj(steering[:, self._first]) * steering[:, self._second] * (2 / microphones)
        trace = np.full_like(steering[:, :1].real, 1 / microphones)
        self._products = np.concatenate([trace, pairs.real, -pairs.imag], axis=1, dtype=np.float32)
        signs = np.ones((halves, 1 + 2 * number), dtype=np.float32)
        signs[1:, 1 + number :] = -1
        self._signs = signs
        """Signs of the coefficients for each half"""

    def outer(self, vectors: ComplexArray) -> ComplexArray:
        """u_i conj(u_j) of all pairs of vectors (N, ...): (N (N - 1) / 2, ...)."""
        products: ComplexArray = vectors[self._first] * np.conj(vectors[self._second])
        return products

    def entries(self, matrices: ComplexArray) -> ComplexArray:
        """Entries (N (N - 1) / 2, 1, F) above the diagonals of matrices (F, N, N)."""
        above: ComplexArray = matrices[:, self._first, self._second].T[:, None]
        return above

    def projector_power(self, projector: ComplexArray, rank: int) -> FloatArray:
        """||Us^H a||^2 / N (F, A) float32 of projectors Us Us^H (N, N, F) of this rank."""
        return self.power(rank, projector[self._first, self._second][:, None])[:, 0]

    def power(self, trace: float, pairs: ComplexArray) -> FloatArray:
        """a^H P a / N of K matrices per bin.

        Parameters
        ----------
        trace : float
            Trace of every matrix.
        pairs : (N (N - 1) / 2, K, F) complex64
            Entries P_ij as ``outer`` orders them.

        Returns
        -------
        power : (F, K, A) float32
        """
        number, count, bins = pairs.shape
        columns = np.empty((1 + 2 * number, count, bins), dtype=np.float32)
        columns[0] = trace
        columns[1 : 1 + number] = pairs.real
        columns[1 + number :] = pairs.imag
        rows = np.empty((bins, count, *self._signs.shape), dtype=np.float32)
        rows[:, :, 0] = columns.transpose(2, 1, 0)
        for half in range(1, len(self._signs)):
            np.multiply(rows[:, :, 0], self._signs[half], out=rows[:, :, half])
        power: FloatArray = rows.reshape(bins, -1, len(columns)) @ self._products
        return power.reshape(bins, count, self._azimuths)


def pair_products(steering: ComplexArray) -> PairProducts | None:
    """The products of steering vectors (F, N, A).

    The result is None for more than ``MOST_PLANES`` microphones and for whitened steering vectors.
    """
    delays_alone = np.allclose(np.abs(steering), 1, atol=1e-5)
    few = steering.shape[1] <= MOST_PLANES
    return PairProducts(steering) if few and delays_alone else None


def _in_opposite_pairs(steering: ComplexArray) -> bool:
    """Whether the second half of the azimuths is opposite the first."""
    first, second = np.array_split(steering, 2, axis=2)
    return first.shape == second.shape and np.allclose(second, np.conj(first), atol=1e-4)
