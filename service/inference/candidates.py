"""Candidate sources by detect-and-remove on block spectra, and their description for counting.

Sources rarely dominate the same time-frequency cell. So the highest peak of the fused spectrum is
taken, the cells that point to it are dropped, and the rest is fused again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.fusion import attention_fusion
from service.doa.peaks import Peak, circular_difference, find_peaks
from service.doa.types import FloatArray

NUM_CANDIDATES = 4
NUM_DESCRIPTORS = 12
REMOVAL_LEVEL = 0.7**2
"""Cells whose squared spectrum at a found peak exceeds this belong to that source"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    azimuth: FloatArray
    """(K,) radians; NaN where no further peak was found"""
    descriptors: FloatArray
    """(K, 12) float32, the source-count network's input"""
    fused: FloatArray
    """(A,) the fused spectrum before any removal"""


def find_candidates(
    spectra: FloatArray, attention: FloatArray, dominance: float, num_microphones: int
) -> Candidates:
    """Detect and remove up to four sources.

    Parameters
    ----------
    spectra : (F, K, A) float32
        Squared MUSIC spectra of the cells of F bins, maximum 1 each.
    attention : (F, K) float32
        Non-negative.
    dominance : float
        Attention-weighted mean dominance of the window's cells, in [0, 1].
    num_microphones : int
    """
    cells = spectra.reshape(-1, spectra.shape[-1])
    remaining = attention.reshape(-1)
    total = float(attention.sum())
    first = fused = attention_fusion(cells, remaining)
    azimuths = np.full(NUM_CANDIDATES, np.nan)
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    for rank in range(NUM_CANDIDATES):
        peaks = find_peaks(fused, 2)
        if not peaks or total <= 0:
            break
        azimuth = peaks[0].azimuth
        index = round(azimuth / (2 * np.pi) * fused.size) % fused.size
        belongs = cells[:, index] > REMOVAL_LEVEL
        support = np.where(belongs, remaining, np.float32(0))
        earlier = [abs(circular_difference(azimuth, a)) for a in azimuths[:rank]]
        descriptors[rank] = (
            *_describe_peaks(peaks, fused),
            *_describe_support(support.reshape(attention.shape) / np.float32(total)),
            float(remaining.sum()) / total,
            float(first[index]),
            min(earlier, default=np.pi) / np.pi,
            dominance,
            0.1 * float(np.log(total / attention.size + 1e-6)),
            num_microphones / 8,
        )
        azimuths[rank] = azimuth
        remaining = remaining - support
        fused = attention_fusion(cells, remaining)
    return Candidates(azimuths, descriptors, first)


def _describe_peaks(peaks: Sequence[Peak], fused: FloatArray) -> tuple[float, float, float]:
    """Height of the highest peak, the spectrum's mean, and the second peak against the first."""
    second = peaks[1].height / peaks[0].height if len(peaks) > 1 else 0.0
    return peaks[0].height, float(fused.mean()), second


def _describe_support(support: FloatArray) -> tuple[float, float, float]:
    """Share of all attention that points to the peak, and its spread over time and frequency."""
    return float(support.sum()), _spread(support.sum(axis=0)), _spread(support.sum(axis=1))


def _spread(weights: FloatArray) -> float:
    """Over which share of its places a weight is spread: 1 where evenly, 1 / size where at one."""
    squares = float(np.square(weights).sum()) * weights.size
    return float(weights.sum()) ** 2 / squares if squares > 0 else 0.0
