"""Descriptors of a candidate direction, the source-count network's input.

They depend on the array's geometry only by its number of microphones and its resolution.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.types import FloatArray
from service.inference.field import Field, FoundCandidate

NUM_DESCRIPTORS = 21
MOST_TRAINED = 8
"""Most microphones of the arrays that the source-count network was trained on; larger arrays count
as arrays of eight"""
OF_WINDOW = slice(10, 14)
"""Descriptors that all candidates of a window share: its attention to dominated cells, loudness,
number of microphones and resolution"""
SHARP_LEVEL = 0.9
TINY = np.finfo(np.float32).tiny
"""Least divisor"""


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
        *_peak_shapes(field, findings),
        mass,
        _spread(in_time),
        _spread(in_bins),
        remaining.sum(axis=1) / total,
        findings[0].fused[[found.index for found in findings]],
        _nearest_earlier(field, findings),
        field.attention @ field.dominance / total,
        0.1 * np.log(total / cells + 1e-6),  # loudness
        min(field.array.num_microphones, MOST_TRAINED) / MOST_TRAINED,
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


def _peak_shapes(field: Field, findings: Sequence[FoundCandidate]) -> tuple[FloatArray, ...]:
    """Peak heights, spectra's means, second peaks against the first, falls over 10 degrees."""
    fused = np.array([found.fused for found in findings])
    heights = np.array([found.heights[0] for found in findings])
    second = np.array([found.heights[1] if len(found.heights) > 1 else 0 for found in findings])
    sides = field.sides(findings)
    return heights, fused.sum(axis=1) / fused.shape[1], second / heights, sides / heights


def _nearest_earlier(field: Field, findings: Sequence[FoundCandidate]) -> FloatArray:
    """(n,) distance of every candidate to the nearest earlier one, in units of pi."""
    return np.array(
        [
            min((field.between(found, other) for other in findings[:rank]), default=np.pi) / np.pi
            for rank, found in enumerate(findings)
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
    offset = np.array(
        [
            field.block_peaks(found, each)
            for each, found in zip(attention.swapaxes(0, 1), findings, strict=True)
        ]
    ) * np.float32(18 / np.pi)  # (n, K - 1, 1 or 2)
    mass = np.maximum(weight.sum(axis=1), TINY)
    mean = (weight[..., None] * offset).sum(axis=1) / mass[:, None]
    offset -= mean[:, None]
    spread = np.sqrt(np.vecdot(weight, np.square(offset).sum(axis=-1)) / mass)
    steps = np.minimum(weight[:, 1:], weight[:, :-1])
    moved = np.vecdot(steps, np.linalg.norm(offset[:, 1:] - offset[:, :-1], axis=-1))
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
