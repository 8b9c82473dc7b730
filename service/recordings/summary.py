"""One short list of directions for a whole recording."""

from __future__ import annotations

from array import array
from collections.abc import Iterable

import numpy as np

from service.doa.peaks import find_peaks
from service.doa.scoring import circular_error
from service.doa.sphere import azimuth_elevation, whole_sphere
from service.doa.steering import azimuth_grid, unit_vectors
from service.doa.types import FloatArray, IntArray
from service.recordings.results import SummarySource, WindowResult

KERNEL = np.deg2rad(5.0)
SPHERE_KERNEL = np.deg2rad(8.0)
"""Wider on the sphere, whose grid is coarser"""
SEPARATION = np.deg2rad(15.0)
"""Radians within which estimates of a recording are one source"""
LEAST_SHARE = 0.1
MAX_SUMMARY = 8
VOTES_AT_A_TIME = 256


def summarise(windows: Iterable[WindowResult], most: int | None = None) -> list[SummarySource]:
    """Cluster the windows' sources, the most frequent first.

    Every estimate votes with its confidence under a Gaussian kernel, and the votes' maxima are
    the sources. Those heard in under a tenth of the windows with any source are left out. Of more
    than ``most``, those of the highest confidence over all these windows stay.
    """
    owner, azimuth, elevation, confidence = _columns(windows)
    if not len(owner):
        return []
    heard = int(owner[-1]) + 1
    level = bool(np.isnan(elevation).any())
    directions = unit_vectors(azimuth, 0.0 if level else elevation)
    peaks = _peaks(azimuth, confidence) if level else _sphere_peaks(directions, confidence)
    errors = np.arccos(np.clip(directions @ peaks.T, -1, 1))
    nearest = np.where(errors.min(axis=1) <= SEPARATION, errors.argmin(axis=1), -1)
    sources = []
    for peak in range(len(peaks)):
        members = nearest == peak
        share = len(np.unique(owner[members])) / heard
        if members.any() and share >= LEAST_SHARE:
            mean = (confidence[members] + 1e-3) @ directions[members]
            towards, height = azimuth_elevation(mean)
            chance = float(confidence[members].mean())
            sources.append(SummarySource(towards, chance, float(share), None if level else height))
    sources.sort(key=lambda source: -source.share * source.confidence)
    return sorted(sources[:most], key=lambda source: -source.share)


def _columns(
    windows: Iterable[WindowResult],
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Every source's window, counted among those that hold any, its angles and confidence.

    An elevation that is not told is NaN.
    """
    owner = array("q")
    azimuth, elevation, confidence = array("d"), array("d"), array("d")
    heard = (window.estimate.sources for window in windows if window.estimate.sources)
    for index, sources in enumerate(heard):
        for source in sources:
            owner.append(index)
            azimuth.append(source.azimuth)
            elevation.append(np.nan if source.elevation is None else source.elevation)
            confidence.append(source.confidence)
    angles = np.array(azimuth), np.array(elevation)
    return np.array(owner, dtype=np.int64), *angles, np.array(confidence)


def _peaks(azimuth: FloatArray, confidence: FloatArray) -> FloatArray:
    """Unit vectors (P, 3) of the maxima of the votes on the circle."""
    votes = _votes(azimuth, confidence)
    found = find_peaks(votes, MAX_SUMMARY, min_separation=SEPARATION)
    return unit_vectors(np.array([peak.azimuth for peak in found]))


def _sphere_peaks(directions: FloatArray, confidence: FloatArray) -> FloatArray:
    """Unit vectors (P, 3) of the maxima of the votes of directions (K, 3) on the sphere."""
    grid = whole_sphere()
    votes = np.zeros(grid.size)
    for first in range(0, len(directions), VOTES_AT_A_TIME):
        part = slice(first, first + VOTES_AT_A_TIME)
        angles = np.arccos(np.clip(grid.vectors @ directions[part].T, -1, 1))
        votes += np.exp(-0.5 * (angles / SPHERE_KERNEL) ** 2) @ (confidence[part] + 1e-3)
    kept: list[FloatArray] = []
    for index in grid.peaks(votes, 2 * MAX_SUMMARY):
        vertex = grid.vertex(votes, index)
        if all(vertex @ other < np.cos(SEPARATION) for other in kept):
            kept.append(vertex)
    return np.array(kept[:MAX_SUMMARY])


def _votes(azimuth: FloatArray, confidence: FloatArray) -> FloatArray:
    """(360,) votes of all estimates for every degree, computed in parts: each takes 9 kB."""
    grid = azimuth_grid()[:, None]
    votes = np.zeros(len(grid))
    for first in range(0, len(azimuth), VOTES_AT_A_TIME):
        part = slice(first, first + VOTES_AT_A_TIME)
        distances = circular_error(grid, azimuth[None, part])
        # A report of zero confidence still gives a small vote.
        votes += np.exp(-0.5 * (distances / KERNEL) ** 2) @ (confidence[part] + 1e-3)
    return votes
