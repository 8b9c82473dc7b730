"""The blocks of frames that a stream's result looks back on, and their sum.

Each has a place in arrays that stay where they are: a step writes the one or two blocks that are
new and the one that has become final, and reads all of them.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray
from service.inference.candidates import Candidates, find_candidates
from service.inference.weights import CandidateSearch, principal_eigenvectors

RECENCY = (1.0, 1.0, 1.0, 0.6, 0.3)
"""What the blocks of a result count, newest first; 0.51 to 0.66 s with the open ones. Counting all
five alike finds two who stand 1 % more often and follows one who walks 1.4 degrees worse; four
blocks follow better still, but take the onset of sensor noise for a talker"""
WINDOW_BLOCKS = len(RECENCY)
_RECENCY = np.array(RECENCY, dtype=np.float32)[:, None]


class RecentBlocks:
    """The last blocks of one stream.

    Parameters
    ----------
    search : CandidateSearch
        For their spectra and what is found in them.
    """

    def __init__(self, search: CandidateSearch) -> None:
        self._search = search
        self._passed = 0
        """Blocks that are final, those included that are forgotten"""
        self._last = 0
        """Blocks in all, the open ones included"""
        self._stale: list[int] = []
        """Places whose covariances have no spectra yet"""
        # By place, a block's number modulo WINDOW_BLOCKS; the whole window has the last one.
        self._covariance: ComplexArray | None = None
        """(WINDOW_BLOCKS, F, N, N), F bins or pairs of them"""
        self._attention: FloatArray
        """(WINDOW_BLOCKS, F) means over eight frames, those that are missing being zero"""
        self._dominance: FloatArray
        """(WINDOW_BLOCKS + 1, F)"""
        self._cells: FloatArray | None = None
        """(F, WINDOW_BLOCKS + 1, A) MUSIC spectra, from the first result on"""

    def put(self, covariance: ComplexArray, attention: FloatArray, final: int) -> None:
        """Take the blocks that are not known to be final, oldest first.

        Parameters
        ----------
        covariance : (K, F, N, N) complex64
        attention : (K, F) float32
        final : int
            How many of them are final now; the others will come again.
        """
        if self._covariance is None:
            shape = (WINDOW_BLOCKS, *covariance.shape[1:])
            self._covariance = np.zeros_like(covariance, shape=shape)
            self._attention = np.zeros((WINDOW_BLOCKS, attention.shape[1]), dtype=np.float32)
            self._dominance = np.zeros((WINDOW_BLOCKS + 1, attention.shape[1]), dtype=np.float32)
        self._last = self._passed + len(covariance)
        for number in range(max(self._passed, self._last - WINDOW_BLOCKS), self._last):
            place = number % WINDOW_BLOCKS
            self._covariance[place] = covariance[number - self._passed]
            self._attention[place] = attention[number - self._passed]
            if place not in self._stale:
                self._stale.append(place)
        self._passed += final

    def candidates(self) -> Candidates:
        """What the last blocks show together; there must have been one."""
        count = min(self._last, WINDOW_BLOCKS)
        # Blocks lie by place; ``age`` is a place's rank in time, the oldest first.
        age = (np.arange(count) - (self._last - count)) % count
        recency = _RECENCY[count - 1 - age]
        self._complete(recency)
        attention = self._attention[:count] * recency
        assert self._cells is not None
        cells, dominance = self._cells, self._dominance
        if count < WINDOW_BLOCKS:
            rows = [*range(count), WINDOW_BLOCKS]
            cells, dominance = cells[:, rows], dominance[rows]
        field = self._search.field(
            cells,
            np.concatenate([attention, attention.sum(axis=0, keepdims=True)]),
            np.repeat([[*age.tolist(), count]], len(cells), axis=0).ravel(),
            count,
            dominance,
        )
        return find_candidates(field)

    def _complete(self, recency: FloatArray) -> None:
        """Spectra and dominance of blocks that have none, and of the sum of all.

        At once: small operations cost their calls.
        """
        assert self._covariance is not None
        blocks = self._covariance[: len(recency)]
        whole = (blocks * recency[..., None, None]).sum(axis=0, keepdims=True)
        stale = [self._covariance[place][None] for place in self._stale]
        principal, dominance = principal_eigenvectors(np.concatenate([*stale, whole]))
        cells = self._search.cell_spectra(principal)  # (F, K, A)
        if self._cells is None:
            shape = (len(cells), WINDOW_BLOCKS + 1, cells.shape[2])
            self._cells = np.empty(shape, dtype=np.float32)
        places = [*self._stale, WINDOW_BLOCKS]
        self._cells[:, places] = cells
        self._dominance[places] = dominance
        self._stale.clear()
