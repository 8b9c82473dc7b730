"""Candidate sources by detect-and-remove on block spectra.

Sources rarely dominate the same time-frequency cell. So the highest peak of the fused spectrum is
taken, the cells that point to it are dropped, and the rest is fused again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.fusion import attention_fusion
from service.doa.mirror import into_searched_half
from service.doa.peaks import find_peaks, parabolic_offset
from service.doa.types import FloatArray
from service.inference.descriptors import NUM_DESCRIPTORS, Field, FoundCandidate, describe

NUM_CANDIDATES = 4
REMOVAL_LEVEL = 0.7
"""Cells whose spectrum at a found peak exceeds this belong to that source"""
ELSEWHERE_LEVEL = 0.45
"""Cells whose spectrum at another source exceeds this tell nothing of this one's direction"""
REFINEMENT_REACH = np.deg2rad(10.0)
"""How far a direction may move once the other sources are known: candidates are as far apart"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    azimuth: FloatArray
    """(4,) radians, as found; NaN where no further peak was. In the half of the circle that the
    array tells from the other"""
    descriptors: FloatArray
    """(4, D) float32, the source-count network's input"""
    fused: FloatArray
    """(A,) the fused spectrum before any removal"""
    field: Field
    findings: Sequence[FoundCandidate]
    """Of the candidates that were found"""

    def directions(self, chosen: Sequence[int]) -> list[float]:
        """Azimuths in radians of the candidates that are the sources, found again together."""
        if not chosen:
            return []
        refined = refine(self.field, [self.findings[index] for index in chosen])
        azimuths: list[float] = into_searched_half(self.field.array, refined).tolist()
        return azimuths


def find_candidates(field: Field) -> Candidates:
    """Detect and remove up to four sources."""
    findings = find_findings(field)
    azimuths = np.full(NUM_CANDIDATES, np.nan)
    found = np.array([finding.azimuth for finding in findings])
    azimuths[: len(findings)] = into_searched_half(field.array, found)
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    if findings:
        descriptors[: len(findings)] = describe(field, findings)
        fused = findings[0].fused
    else:
        fused = attention_fusion(field.cells, field.attention)
    return Candidates(azimuths, descriptors, fused, field, findings)


def find_findings(field: Field) -> list[FoundCandidate]:
    """The candidates one after the other, each with the state in which it was found."""
    findings: list[FoundCandidate] = []
    remaining = field.attention
    if not field.total > 0:
        return findings
    while len(findings) < NUM_CANDIDATES:
        fused = attention_fusion(field.cells, remaining)
        peaks = find_peaks(fused, 2)
        if not peaks:
            break
        index = round(peaks[0].azimuth / (2 * np.pi) * fused.size) % fused.size
        pointing = field.cells[:, index].copy()
        support = remaining * (pointing > REMOVAL_LEVEL)
        findings.append(FoundCandidate(peaks, index, fused, pointing, support, remaining))
        remaining = remaining - support
    return findings


def refine(field: Field, sources: Sequence[FoundCandidate]) -> FloatArray:
    """(n,) azimuths in radians of the sources, each at the maximum next to where it was found.

    It is looked for among the cells that point to no other source, which draw the first one's peak
    towards themselves. They count the square root of their attention: the attention picks what
    tells a source from none, and averages over too few cells to say best where a source is
    (docs/training.md, "Where a source is").
    """
    attention = np.sqrt(field.attention)
    pointing = np.array([source.pointing for source in sources])  # (n, C)
    elsewhere = pointing > ELSEWHERE_LEVEL
    of_others = elsewhere.sum(axis=0) > elsewhere
    weights = np.where(of_others, np.float32(0), attention)
    step = 2 * np.pi / field.cells.shape[1]
    reach = round(REFINEMENT_REACH / step)
    azimuths = np.array([source.azimuth for source in sources])
    for number, source in enumerate(sources):
        around = (weights[number] @ field.around(source.index, reach)).tolist()
        place = _uphill(around)
        if place is not None and around[place] > 0:
            moved = place - reach + parabolic_offset(around, place)
            azimuths[number] = (source.index + moved) * step % (2 * np.pi)
    return azimuths


def _uphill(values: Sequence[float]) -> int | None:
    """The local maximum that lies uphill of the middle; None where the ascent meets an end."""
    place = len(values) // 2
    while 0 < place < len(values) - 1:
        highest = max((place, place - 1, place + 1), key=values.__getitem__)
        if highest == place:
            return place
        place = highest
    return None
