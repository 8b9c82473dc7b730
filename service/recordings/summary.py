"""One short list of directions for a whole recording."""

from __future__ import annotations

from array import array
from collections.abc import Iterable

import numpy as np

from service.doa.peaks import find_peaks, wrapped
from service.doa.scoring import circular_error
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray, IntArray
from service.recordings.results import SummarySource, WindowResult

KERNEL = np.deg2rad(5.0)
SEPARATION = np.deg2rad(15.0)
"""Radians within which estimates of a recording are one source"""
LEAST_SHARE = 0.1
MAX_SUMMARY = 8
VOTES_AT_A_TIME = 256


def summarise(windows: Iterable[WindowResult]) -> list[SummarySource]:
    """Cluster the windows' sources on the circle, the most frequent first.

    Every estimate votes with its confidence under a Gaussian kernel, and the votes' maxima are
    the sources. Those heard in under a tenth of the windows with any source are left out.
    """
    owner, azimuth, confidence = _columns(windows)
    if not len(owner):
        return []
    heard = int(owner[-1]) + 1
    votes = _votes(azimuth, confidence)
    peaks = np.array([p.azimuth for p in find_peaks(votes, MAX_SUMMARY, min_separation=SEPARATION)])
    errors = circular_error(azimuth[:, None], peaks[None])
    nearest = np.where(errors.min(axis=1) <= SEPARATION, errors.argmin(axis=1), -1)
    sources = []
    for peak in range(len(peaks)):
        members = nearest == peak
        share = len(np.unique(owner[members])) / heard
        if members.any() and share >= LEAST_SHARE:
            mean = np.angle(np.sum((confidence[members] + 1e-3) * np.exp(1j * azimuth[members])))
            sources.append(
                SummarySource(wrapped(float(mean)), float(confidence[members].mean()), float(share))
            )
    return sorted(sources, key=lambda source: -source.share)


def _columns(windows: Iterable[WindowResult]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Every source's window, counted among those that hold any, its azimuth and confidence."""
    owner, azimuth, confidence = array("q"), array("d"), array("d")
    heard = (window.estimate.sources for window in windows if window.estimate.sources)
    for index, sources in enumerate(heard):
        for source in sources:
            owner.append(index)
            azimuth.append(source.azimuth)
            confidence.append(source.confidence)
    return np.array(owner, dtype=np.int64), np.array(azimuth), np.array(confidence)


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
