"""Descriptors of a candidate direction, the source-count network's input.

They depend on the array's geometry only by its number of microphones and its resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.peaks import Peak, circular_difference
from service.doa.types import BoolArray, FloatArray, IntArray

NUM_DESCRIPTORS = 21
SHARP_LEVEL = 0.9
TINY = np.finfo(np.float32).tiny
"""Least divisor"""
NEIGHBOURHOOD = np.deg2rad(20.0)
"""Radians around a candidate in which blocks' peaks are compared: they agree for one talker, not
for two close ones"""


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

    def around(self, index: int, reach: int) -> FloatArray:
        """(C, 2 reach + 1) spectra up to ``reach`` azimuths around an index, on the circle.

        The result is a view where possible.
        """
        first, last, size = index - reach, index + reach + 1, self.cells.shape[1]
        if first >= 0 and last <= size:
            return self.cells[:, first:last]
        return np.concatenate([self.cells[:, first % size :], self.cells[:, : last % size]], axis=1)


@dataclass(frozen=True, slots=True)
class FoundCandidate:
    """One candidate and the state in which it was found."""

    peaks: Sequence[Peak]
    """The highest peak and, if there is one, the second"""
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

    @property
    def azimuth(self) -> float:
        return self.peaks[0].azimuth


def describe(field: Field, findings: Sequence[FoundCandidate]) -> FloatArray:
    """(n, D) float32 descriptors of a window's candidates, in the order of their discovery."""
    total, of_block = np.float32(field.total), field.of_block
    # np.array of a list: stack takes three times as long.
    support = np.array([found.support for found in findings]) / total  # (n, C)
    pointing = np.array([found.pointing for found in findings])
    remaining = np.array([found.remaining for found in findings])
    in_time = support @ of_block.T  # (n, K)
    in_bins = field.in_bins(support)  # (n, F)
    mass = in_time.sum(axis=1)
    sharp = support * (pointing > SHARP_LEVEL)
    dominant = support @ field.dominance / np.maximum(mass, 1e-9)
    cells = field.num_blocks * field.num_bins  # includes those that were never computed
    columns = [
        *_peak_shapes(findings),
        mass,
        _spread(in_time),
        _spread(in_bins),
        remaining.sum(axis=1) / total,
        findings[0].fused[[found.index for found in findings]],
        _nearest_earlier([found.azimuth for found in findings]),
        field.attention @ field.dominance / total,
        0.1 * np.log(total / cells + 1e-6),  # loudness
        field.array.num_microphones / 8,
        field.resolution,
        dominant,
        sharp.sum(axis=1),
        *_likeness(in_time[:, :-1], in_bins),
        *_disagreement(field, findings, of_block[:-1, None] * remaining, in_time[:, :-1]),
    ]
    descriptors = np.empty((len(findings), NUM_DESCRIPTORS), dtype=np.float32)
    for place, column in enumerate(columns):
        descriptors[:, place] = column
    return descriptors


def _peak_shapes(findings: Sequence[FoundCandidate]) -> tuple[FloatArray, ...]:
    """Peak heights, spectra's means, second peaks against the first, falls over 10 degrees."""
    fused = np.array([found.fused for found in findings])
    rows, size = np.arange(len(findings)), fused.shape[1]
    index = np.array([found.index for found in findings])
    step = max(1, round(size / 36))
    sides = (fused[rows, index - step] + fused[rows, (index + step) % size]) / 2
    heights = np.array([found.peaks[0].height for found in findings])
    second = np.array([found.peaks[1].height if len(found.peaks) > 1 else 0 for found in findings])
    return heights, fused.sum(axis=1) / size, second / heights, sides / heights


def _nearest_earlier(azimuths: Sequence[float]) -> FloatArray:
    """(n,) distance of every candidate to the nearest earlier one, in units of pi."""
    return np.array(
        [
            min((abs(circular_difference(a, b)) for b in azimuths[:rank]), default=np.pi) / np.pi
            for rank, a in enumerate(azimuths)
        ]
    )


def _likeness(in_time: FloatArray, in_bins: FloatArray) -> tuple[FloatArray, ...]:
    """Similarity of candidates to the first one in time, one block later, and in frequency.

    Reflections sound with the talker or just after, in the same bins.
    """
    return (
        _cosine(in_time, in_time[0]),
        _cosine(in_time[:, 1:], in_time[0, :-1]),
        _cosine(in_bins, in_bins[0]),
    )


def _disagreement(
    field: Field, findings: Sequence[FoundCandidate], attention: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Spread of the blocks' own peaks near the candidates, in units of 10 degrees, and its drift.

    The drift is the part of the spread that follows time: talkers that take turns. ``attention``
    (K - 1, n, C) remained before each candidate; ``weight`` (n, K - 1) weighs the blocks.
    """
    size = findings[0].fused.size
    reach = round(NEIGHBOURHOOD / (2 * np.pi) * size)
    blocks = np.array(
        [
            each @ field.around(found.index, reach)
            for each, found in zip(attention.swapaxes(0, 1), findings, strict=True)
        ]
    )  # (n, K - 1, 2 reach + 1)
    offset = (blocks.argmax(axis=2) - reach) * np.float32(36.0 / size)
    mass = np.maximum(weight.sum(axis=1), TINY)
    mean = np.vecdot(weight, offset) / mass
    offset -= mean[:, None]
    spread = np.sqrt(np.vecdot(weight, np.square(offset)) / mass)
    steps = np.minimum(weight[:, 1:], weight[:, :-1])
    moved = np.vecdot(steps, np.abs(offset[:, 1:] - offset[:, :-1]))
    return spread, moved / np.maximum(steps.sum(axis=1), 1e-9)


def _spread(weights: FloatArray) -> FloatArray:
    """Share of its places over which a row's weight is spread: 1 if even, 1 / size if at one."""
    squares = np.maximum(_squares(weights) * weights.shape[1], TINY)
    spread: FloatArray = np.square(weights.sum(axis=1)) / squares
    return spread


def _cosine(rows: FloatArray, reference: FloatArray) -> FloatArray:
    norms = np.sqrt(_squares(rows) * (reference @ reference))
    cosine: FloatArray = (rows @ reference) / np.maximum(norms, TINY)
    return cosine


def _squares(rows: FloatArray) -> FloatArray:
    """(n,) sums of squares of (n, K)."""
    squares: FloatArray = np.vecdot(rows, rows)
    return squares
