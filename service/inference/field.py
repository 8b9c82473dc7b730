"""The cells of one window on the circle of azimuths, in which candidates are found and refined."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.fusion import attention_fusion
from service.doa.peaks import circular_difference, find_peaks, parabolic_offset
from service.doa.types import BoolArray, FloatArray, IntArray

REMOVAL_LEVEL = 0.7
"""Spectrum of a cell at a found peak above which the cell belongs to that source"""
REFINEMENT_REACH = np.deg2rad(10.0)
"""Most that refinement moves a direction, radians: the distance between candidates"""
NEIGHBOURHOOD = np.deg2rad(20.0)
"""Radians around a candidate in which blocks' peaks are compared: they agree for one talker, not
for two close ones"""


@dataclass(frozen=True, slots=True)
class FoundCandidate:
    """One candidate and the state in which it was found."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    heights: Sequence[float]
    """Fused spectrum at the highest peak and, if there is one, at the second"""
    index: int
    """Grid index of the highest peak"""
    fused: FloatArray
    """(A,) fused spectrum of the cells that remained before it"""
    pointing: FloatArray
    """(C,) spectra of the cells at the peak"""
    support: FloatArray
    """(C,) attention of the cells that belong to it"""
    remaining: FloatArray
    """(C,) attention that remained before it"""
    direction: FloatArray | None = None
    """Unit vector (3,); None where only azimuths are searched"""

    @property
    def elevation(self) -> float | None:
        """Radians above the horizontal plane; None where only azimuths are searched."""
        return (
            None
            if self.direction is None
            else math.asin(min(1.0, max(-1.0, float(self.direction[2]))))
        )


@dataclass(frozen=True)
class Field:
    """The C cells of one window in which candidates are found; A azimuths, K blocks.

    Cells are ordered by bin (or pair of bins), with the same number in each.
    """

    cells: FloatArray
    """(C, A) float32 MUSIC spectra, maximum 1 each"""
    attention: FloatArray
    """(C,) float32, non-negative"""
    dominance: FloatArray
    """(C,) float32 in (0, 1]"""
    block: IntArray
    """(C,) block of every cell; the last of K is the whole window"""
    num_bins: int
    num_blocks: int
    """K, the whole window included"""
    array: MicrophoneArray
    resolution: float
    """Resolution of the array, from ``service.doa.steering.resolution``"""

    @property
    def total(self) -> float:
        """Sum of the attention."""
        return float(self.attention.sum())

    @property
    def of_block(self) -> FloatArray:
        """(K, C) float32: 1 where a cell belongs to a block."""
        same: BoolArray = self.block == np.arange(self.num_blocks)[:, None]
        return same.astype(np.float32)

    def in_bins(self, weights: FloatArray) -> FloatArray:
        """Sums (..., F) over each bin's cells of (..., C)."""
        count = len(self.block) // self.num_bins
        cells = weights.reshape(*weights.shape[:-1], self.num_bins, count)
        sums: FloatArray = cells @ np.ones(count, dtype=np.float32)  # a short axis sums slowly
        return sums

    def azimuth_spectrum(self, fused: FloatArray) -> FloatArray:
        """A fused spectrum on the grid of azimuths: this one."""
        return fused

    def image(self, fused: FloatArray) -> FloatArray | None:
        """A fused spectrum as an image of the sphere, of which azimuths alone have none."""
        return None

    def find(self, remaining: FloatArray) -> FoundCandidate | None:
        """The highest peak of the cells with the attention (C,) that remains, if there is one."""
        fused = attention_fusion(self.cells, remaining)
        peaks = find_peaks(fused, 2)
        if not peaks:
            return None
        index = round(peaks[0].azimuth / (2 * np.pi) * fused.size) % fused.size
        pointing = self.cells[:, index].copy()
        support = remaining * (pointing > REMOVAL_LEVEL)
        heights = [peak.height for peak in peaks]
        return FoundCandidate(peaks[0].azimuth, heights, index, fused, pointing, support, remaining)

    def refined(self, source: FoundCandidate, weights: FloatArray) -> tuple[float, float | None]:
        """Azimuth and elevation of the maximum next to a source, with these weights (C,)."""
        step = 2 * np.pi / self.cells.shape[1]
        reach = round(REFINEMENT_REACH / step)
        around = (weights @ self.around(source.index, reach)).tolist()
        place = _uphill(around)
        if place is None or not around[place] > 0:
            return source.azimuth, None
        shift = place - reach + parabolic_offset(around, place)
        return (source.index + shift) * step % (2 * np.pi), None

    def around(self, index: int, reach: int) -> FloatArray:
        """(C, 2 reach + 1) spectra up to ``reach`` azimuths around an index, on the circle.

        The result is a view where possible.
        """
        first, last, size = index - reach, index + reach + 1, self.cells.shape[1]
        if first >= 0 and last <= size:
            return self.cells[:, first:last]
        return np.concatenate([self.cells[:, first % size :], self.cells[:, : last % size]], axis=1)

    def sides(self, findings: Sequence[FoundCandidate]) -> FloatArray:
        """(n,) mean of each candidate's fused spectrum 10 degrees beside its peak."""
        fused = np.array([found.fused for found in findings])
        rows, size = np.arange(len(findings)), fused.shape[1]
        index = np.array([found.index for found in findings])
        step = max(1, round(size / 36))
        sides: FloatArray = (fused[rows, index - step] + fused[rows, (index + step) % size]) / 2
        return sides

    def between(self, one: FoundCandidate, other: FoundCandidate) -> float:
        """Angle between two candidates in radians."""
        return abs(circular_difference(one.azimuth, other.azimuth))

    def block_peaks(self, found: FoundCandidate, attention: FloatArray) -> FloatArray:
        """(K - 1, 1) radians from a candidate to the highest values near it of every block.

        ``attention`` (K - 1, C) is each block's own.
        """
        size = self.cells.shape[1]
        reach = round(NEIGHBOURHOOD / (2 * np.pi) * size)
        highest = (attention @ self.around(found.index, reach)).argmax(axis=1)
        offset: FloatArray = (highest - reach)[:, None] * np.float32(2 * np.pi / size)
        return offset


def _uphill(values: Sequence[float]) -> int | None:
    """Index of the local maximum uphill from the middle; None where the ascent meets an end."""
    place = len(values) // 2
    while 0 < place < len(values) - 1:
        highest = max((place, place - 1, place + 1), key=values.__getitem__)
        if highest == place:
            return place
        place = highest
    return None
