"""The blocks of frames behind a stream's result, and their sum.

Each block has a fixed place in the arrays: a step writes the one or two new blocks and the one that
has become final, and reads all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from service.doa.pose import Rotation, mean_rotation
from service.doa.types import ComplexArray, FloatArray, IntArray
from service.inference.candidates import Candidates, find_candidates
from service.inference.weights import CandidateSearch, principal_eigenvectors

RECENCY = (1.0, 1.0, 1.0, 0.6, 0.3)
"""Weights of the blocks of a result, newest first; they span 0.51 to 0.66 s with the open ones.
Equal weights find two standing talkers 1 % more often and follow a walking one 1.4 degrees worse.
Four blocks follow better still, but take the onset of sensor noise for a talker."""
WINDOW_BLOCKS = len(RECENCY)
_RECENCY = np.array(RECENCY, dtype=np.float32)[:, None]
STILL_ENOUGH = np.deg2rad(0.5)
"""Radians by which blocks may be turned against each other and count as not turned"""
ALIKE = np.deg2rad(4.0)
"""Radians of turn from the newest block at which a block counts little in the whole window, whose
covariance cannot be turned"""

Headings = Callable[[float], Rotation]
"""The array's rotation into the world's frame at a frame of the stream, counted from its first"""


class RecentBlocks:
    """The last blocks of one stream.

    Parameters
    ----------
    search : CandidateSearch
        Computes their spectra and finds the candidates.
    """

    def __init__(self, search: CandidateSearch) -> None:
        self._search = search
        self._passed = 0
        """Number of final blocks, forgotten ones included"""
        self._last = 0
        """Number of all blocks, open ones included"""
        self._stale: list[int] = []
        """Places of covariances without spectra"""
        # A block's place is its number modulo WINDOW_BLOCKS; the whole window has the last place.
        self._covariance: ComplexArray | None = None
        """(WINDOW_BLOCKS, F, N, N), F bins or pairs of them"""
        self._centres = [0.0] * WINDOW_BLOCKS
        """Frame in the middle of every block, counted from the stream's first"""
        self._attention: FloatArray
        """(WINDOW_BLOCKS, F) means over eight frames; missing frames count as zero"""
        self._dominance: FloatArray
        """(WINDOW_BLOCKS + 1, F)"""
        self._principal: ComplexArray
        """(WINDOW_BLOCKS + 1, F, N)"""
        self._cells: FloatArray | None = None
        """(F, WINDOW_BLOCKS + 1, A) MUSIC spectra, from the first result on"""

    def put(
        self,
        covariance: ComplexArray,
        attention: FloatArray,
        centres: Sequence[float],
        final: int,
    ) -> None:
        """Take the blocks that were not final yet, oldest first.

        Parameters
        ----------
        covariance : (K, F, N, N) complex64
        attention : (K, F) float32
        centres : (K,)
            Frames, counted from the stream's first, about which their sound lies.
        final : int
            Number of them that are final now; the others will come again.
        """
        if self._covariance is None:
            shape = (WINDOW_BLOCKS, *covariance.shape[1:])
            self._covariance = np.zeros_like(covariance, shape=shape)
            self._attention = np.zeros((WINDOW_BLOCKS, attention.shape[1]), dtype=np.float32)
            self._dominance = np.zeros((WINDOW_BLOCKS + 1, attention.shape[1]), dtype=np.float32)
            places, (_, bins, microphones, _) = WINDOW_BLOCKS + 1, covariance.shape
            self._principal = np.zeros((places, bins, microphones), dtype=np.complex64)
        self._last = self._passed + len(covariance)
        for number in range(max(self._passed, self._last - WINDOW_BLOCKS), self._last):
            place = number % WINDOW_BLOCKS
            self._covariance[place] = covariance[number - self._passed]
            self._attention[place] = attention[number - self._passed]
            self._centres[place] = centres[number - self._passed]
            if place not in self._stale:
                self._stale.append(place)
        self._passed += final

    def candidates(self, headings: Headings | None = None) -> tuple[Candidates, Rotation | None]:
        """The candidates in the last blocks, of which there must be one.

        With ``headings`` every block is turned into the frame of the newest one, whose rotation
        into the world's comes with the candidates.
        """
        count = min(self._last, WINDOW_BLOCKS)
        # Arrays are ordered by place; ``age`` is a place's rank in time, oldest first.
        age = (np.arange(count) - (self._last - count)) % count
        recency = _RECENCY[count - 1 - age]
        turns, newest = self._turns(age, headings)
        whole = recency
        if turns is not None:
            angles = np.array([turn.angle for turn in turns], dtype=np.float32)
            whole = recency * np.exp(-0.5 * (angles / np.float32(ALIKE)) ** 2)[:, None]
            together = mean_rotation([turns[i] for i in np.flatnonzero(angles < ALIKE)])
            turns.append(together)
        self._complete(whole)
        attention = self._attention[:count]
        assert self._cells is not None
        cells, dominance, principal = self._cells, self._dominance, self._principal
        if count < WINDOW_BLOCKS:
            rows = [*range(count), WINDOW_BLOCKS]
            cells, dominance, principal = cells[:, rows], dominance[rows], principal[rows]
        field = self._search.field(
            cells,
            np.concatenate([attention * recency, (attention * whole).sum(axis=0, keepdims=True)]),
            np.repeat([[*age.tolist(), count]], len(cells), axis=0).ravel(),
            count,
            dominance,
            principal,
            turns,
        )
        return find_candidates(field), newest

    def _turns(
        self, age: IntArray, headings: Headings | None
    ) -> tuple[list[Rotation] | None, Rotation | None]:
        """Every block's rotation into the newest one's frame, None where none is turned.

        The newest one's rotation into the world's frame comes second.
        """
        if headings is None:
            return None, None
        rotations = [headings(centre) for centre in self._centres[: len(age)]]
        newest = rotations[int(age.argmax())]
        turns = [newest.inverse.after(rotation) for rotation in rotations]
        turned = any(turn.angle > STILL_ENOUGH for turn in turns)
        return turns if turned else None, newest

    def _complete(self, recency: FloatArray) -> None:
        """Compute spectra and dominance of blocks without them, and of the weighted sum of all.

        One call computes all of them: small operations cost their calls.
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
        self._principal[places] = principal
        self._stale.clear()
