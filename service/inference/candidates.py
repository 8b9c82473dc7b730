"""Candidate sources by detect-and-remove on block spectra.

Sources rarely dominate the same time-frequency cell. So the highest peak of the fused spectrum is
taken, the cells that point to it are dropped, and the rest is fused again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.peaks import find_peaks
from service.doa.types import FloatArray
from service.inference.descriptors import NUM_DESCRIPTORS, Field, Finding, describe

NUM_CANDIDATES = 4
REMOVAL_LEVEL = 0.7
"""Cells whose spectrum at a found peak exceeds this belong to that source"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    azimuth: FloatArray
    """(4,) radians; NaN where no further peak was found"""
    descriptors: FloatArray
    """(4, D) float32, the source-count network's input"""
    fused: FloatArray
    """(A,) the fused spectrum before any removal"""


def find_candidates(field: Field) -> Candidates:
    """Detect and remove up to four sources."""
    remaining = field.attention
    blocks = block_fusion(field.cells, remaining)
    findings: list[Finding] = []
    fused = first = _mean(blocks, remaining)
    while len(findings) < NUM_CANDIDATES and field.total > 0:
        peaks = find_peaks(fused, 2)
        if not peaks:
            break
        index = round(peaks[0].azimuth / (2 * np.pi) * fused.size) % fused.size
        pointing = field.cells[:, :, index]
        support = np.where(pointing > REMOVAL_LEVEL, remaining, np.float32(0))
        findings.append(Finding(peaks, index, fused, blocks, pointing, support, remaining))
        remaining = remaining - support
        blocks = block_fusion(field.cells, remaining)
        fused = _mean(blocks, remaining)
    azimuths = np.full(NUM_CANDIDATES, np.nan)
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    for rank, finding in enumerate(findings):
        azimuths[rank] = finding.azimuth
        descriptors[rank] = describe(field, findings[: rank + 1])
    return Candidates(azimuths, descriptors, first)


def block_fusion(cells: FloatArray, attention: FloatArray) -> FloatArray:
    """Attention-weighted sum over the bins alone: (F, K, A) and (F, K) to (K, A)."""
    return np.stack([attention[:, block] @ cells[:, block] for block in range(cells.shape[1])])


def _mean(blocks: FloatArray, attention: FloatArray) -> FloatArray:
    fused: FloatArray = blocks.sum(axis=0) / max(float(attention.sum()), 1e-30)
    return fused
