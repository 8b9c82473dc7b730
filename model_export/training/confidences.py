"""Confidences in bins against the truth, and their expected calibration error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.types import BoolArray, FloatArray

HIT_DEG = 10.0
"""Degrees; a confidence is the chance that a source is within this angle"""
NUM_BINS = 10


@dataclass(frozen=True, slots=True)
class Bin:
    """Reported sources whose confidences lie in one interval."""

    low: float
    high: float
    sources: int
    mean_confidence: float
    share_right: float


def confidence_bins(confidence: FloatArray, right: BoolArray) -> list[Bin]:
    """Bins of confidences (K,) in [0, 1] with the truth (K,), without empty bins."""
    index = np.minimum((confidence * NUM_BINS).astype(int), NUM_BINS - 1)
    return [
        Bin(
            low=round(float(bin_ / NUM_BINS), 6),
            high=round(float((bin_ + 1) / NUM_BINS), 6),
            sources=int((index == bin_).sum()),
            mean_confidence=float(confidence[index == bin_].mean()),
            share_right=float(right[index == bin_].mean()),
        )
        for bin_ in np.unique(index)
    ]


def calibration_error(bins: Sequence[Bin]) -> float:
    """Expected calibration error, in [0, 1]; 0 where nothing was reported.

    References
    ----------
    Guo, Pleiss, Sun, Weinberger, 2017, On calibration of modern neural networks, eq. (3).
    """
    total = sum(bin_.sources for bin_ in bins)
    gaps = [bin_.sources * abs(bin_.mean_confidence - bin_.share_right) for bin_ in bins]
    return float(sum(gaps) / total) if total else 0.0
