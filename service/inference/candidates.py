"""Candidate sources by detect-and-remove on block spectra, and their description for counting.

Sources rarely dominate the same time-frequency cell. So the highest peak of the fused spectrum is
taken, the cells that point to it are dropped, and the rest is fused again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.fusion import attention_fusion
from service.doa.peaks import circular_difference, find_peaks
from service.doa.types import FloatArray

NUM_CANDIDATES = 4
NUM_DESCRIPTORS = 8
REMOVAL_LEVEL = 0.7**2
"""Cells whose squared spectrum at a found peak exceeds this belong to that source"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    azimuth: FloatArray
    """(K,) radians; NaN where no further peak was found"""
    descriptors: FloatArray
    """(K, 8) float32, the source-count network's input"""
    fused: FloatArray
    """(A,) the fused spectrum before any removal"""


def find_candidates(spectra: FloatArray, attention: FloatArray, dominance: float) -> Candidates:
    """Detect and remove up to four sources.

    Parameters
    ----------
    spectra : (K, A) float32
        Squared MUSIC spectra of K frequency-and-block cells, maximum 1 each.
    attention : (K,) float32
        Non-negative.
    dominance : float
        Attention-weighted mean dominance of the window's cells, in [0, 1].
    """
    total = float(attention.sum())
    remaining = attention
    first = fused = attention_fusion(spectra, attention)
    azimuths = np.full(NUM_CANDIDATES, np.nan)
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    for rank in range(NUM_CANDIDATES):
        peaks = find_peaks(fused, 1)
        if not peaks or total <= 0:
            break
        peak = peaks[0]
        index = round(peak.azimuth / (2 * np.pi) * fused.size) % fused.size
        belongs = spectra[:, index] > REMOVAL_LEVEL
        gap = min(
            (abs(circular_difference(peak.azimuth, a)) for a in azimuths[:rank]), default=np.pi
        )
        descriptors[rank] = (
            peak.height,
            float(fused.mean()),
            float(remaining[belongs].sum()) / total,
            float(remaining.sum()) / total,
            float(first[index]),
            gap / np.pi,
            dominance,
            0.1 * float(np.log(total / attention.size + 1e-6)),
        )
        azimuths[rank] = peak.azimuth
        remaining = np.where(belongs, np.float32(0), remaining)
        fused = attention_fusion(spectra, remaining)
    return Candidates(azimuths, descriptors, first)
