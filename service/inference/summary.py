"""One short list of directions for a whole recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.peaks import find_peaks
from service.doa.scoring import circular_error
from service.doa.steering import azimuth_grid
from service.inference.results import SummarySource, WindowResult

KERNEL = np.deg2rad(5.0)
SEPARATION = np.deg2rad(15.0)
"""Radians: estimates this close over a recording are one source"""
LEAST_SHARE = 0.1
MAX_SUMMARY = 8


def summarise(windows: Sequence[WindowResult]) -> list[SummarySource]:
    """Cluster the windows' sources on the circle, the most frequent first.

    Every estimate votes with its confidence under a Gaussian kernel; the votes' maxima are the
    sources, and those in under a tenth of the windows that hold any source are left out.
    """
    heard = [window for window in windows if window.estimate.sources]
    if not heard:
        return []
    estimates = [
        (index, source.azimuth, source.confidence)
        for index, window in enumerate(heard)
        for source in window.estimate.sources
    ]
    owner, azimuth, confidence = (np.array(column) for column in zip(*estimates, strict=True))
    distances = circular_error(azimuth_grid()[:, None], azimuth[None])
    # A vote of zero confidence still marks where something was reported.
    votes = (np.exp(-0.5 * (distances / KERNEL) ** 2) @ (confidence + 1e-3)).astype(np.float64)
    peaks = np.array([p.azimuth for p in find_peaks(votes, MAX_SUMMARY, min_separation=SEPARATION)])
    errors = circular_error(azimuth[:, None], peaks[None])
    nearest = np.where(errors.min(axis=1) <= SEPARATION, errors.argmin(axis=1), -1)
    sources = []
    for peak in range(len(peaks)):
        members = nearest == peak
        share = len(set(owner[members])) / len(heard)
        if members.any() and share >= LEAST_SHARE:
            mean = np.angle(np.sum((confidence[members] + 1e-3) * np.exp(1j * azimuth[members])))
            sources.append(
                SummarySource(
                    float(mean % (2 * np.pi)), float(confidence[members].mean()), float(share)
                )
            )
    return sorted(sources, key=lambda source: -source.share)
