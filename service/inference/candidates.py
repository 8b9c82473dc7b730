"""Candidate sources by detect-and-remove on block spectra.

Sources rarely dominate the same time-frequency cell. So the highest peak of the fused spectrum is
taken, the cells that point to it are dropped, and the rest is fused again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.fusion import attention_fusion
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
    findings = find_findings(field)
    azimuths = np.full(NUM_CANDIDATES, np.nan)
    azimuths[: len(findings)] = [finding.azimuth for finding in findings]
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    if findings:
        descriptors[: len(findings)] = describe(field, findings)
        return Candidates(azimuths, descriptors, findings[0].fused)
    return Candidates(azimuths, descriptors, attention_fusion(field.cells, field.attention))


def find_findings(field: Field) -> list[Finding]:
    """The candidates one after the other, each with the state in which it was found."""
    findings: list[Finding] = []
    remaining = field.attention
    while field.total > 0 and len(findings) < NUM_CANDIDATES:
        fused = attention_fusion(field.cells, remaining)
        peaks = find_peaks(fused, 2)
        if not peaks:
            break
        index = round(peaks[0].azimuth / (2 * np.pi) * fused.size) % fused.size
        pointing = field.cells[:, index].copy()
        support = np.where(pointing > REMOVAL_LEVEL, remaining, np.float32(0))
        findings.append(Finding(peaks, index, fused, pointing, support, remaining))
        remaining = remaining - support
    return findings
