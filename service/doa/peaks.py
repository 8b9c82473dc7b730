"""Peaks of a spatial spectrum on the circle, refined below the grid's step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.types import FloatArray

TURN = 2 * math.pi


@dataclass(frozen=True, slots=True)
class Peak:
    """One local maximum of a spatial spectrum."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    height: float
    """The spectrum's value at the nearest grid angle"""


def find_peaks(
    spectrum: FloatArray, max_peaks: int, *, min_separation: float = np.deg2rad(10.0)
) -> list[Peak]:
    """The largest circular local maxima, highest first.

    Parameters
    ----------
    spectrum : (A,) float
        Values on ``azimuth_grid(A)``; index 0 and A - 1 are neighbours.
    max_peaks : int
        Most peaks in the result.
    min_separation : float
        Radians; of two maxima closer than this only the higher one counts.

    Returns
    -------
    peaks : list of Peak
        Fewer than ``max_peaks`` where the spectrum has fewer maxima; a constant one has none.
    """
    closed = np.concatenate([spectrum[-1:], spectrum, spectrum[:1]])
    # The strict side makes a plateau of two equal samples one maximum instead of none or two.
    rises = closed[1:] > closed[:-1]
    candidates = np.flatnonzero(rises[:-1] > rises[1:]).tolist()
    values = spectrum.tolist()  # reading numpy's scalars costs ten times as much
    order = sorted(candidates, key=values.__getitem__, reverse=True)
    step = 2 * np.pi / spectrum.size
    kept: list[Peak] = []
    for index in order:
        if len(kept) == max_peaks:
            break
        azimuth = wrapped((index + parabolic_offset(values, index)) * step)
        if all(abs(circular_difference(azimuth, peak.azimuth)) >= min_separation for peak in kept):
            kept.append(Peak(azimuth, values[index]))
    return kept


def parabolic_offset(spectrum: Sequence[float], index: int) -> float:
    """Vertex of the parabola through three circular neighbours, in grid steps from the middle.

    The parabola is laid through the reciprocals: near a source the MUSIC denominator is quadratic
    in the angle, so its reciprocal's vertex is exact where the spectrum's own would be biased.
    """
    around = (spectrum[index - 1], spectrum[index], spectrum[(index + 1) % len(spectrum)])
    before, here, after = (1 / x for x in around) if min(around) > 0 else (-x for x in around)
    curvature = before - 2 * here + after
    if not curvature > 0:
        return 0.0
    return min(max(0.5 * (before - after) / curvature, -0.5), 0.5)


def wrapped(azimuth: float) -> float:
    """Radians in [0, 2 pi), also where the remainder rounds up to a whole turn."""
    remainder = azimuth % TURN
    return remainder if remainder < TURN else 0.0


def circular_difference(first: float, second: float) -> float:
    """``first`` - ``second`` in radians, wrapped to [-pi, pi)."""
    return float((first - second + np.pi) % (2 * np.pi) - np.pi)
