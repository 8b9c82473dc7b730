"""Candidate sources by detect-and-remove on block spectra.

Two sources rarely dominate the same time-frequency cell. So the search takes the highest peak of
the fused spectrum, drops the cells that point to it, and fuses the rest again.
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
"""Spectrum of a cell at a found peak above which the cell belongs to that source"""
ELSEWHERE_LEVEL = 0.45
"""Spectrum of a cell at another source above which it tells nothing about this direction"""
REFINEMENT_REACH = np.deg2rad(10.0)
"""Most that refinement moves a direction, radians: the distance between candidates"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    azimuth: FloatArray
    """(4,) radians as found, NaN where there was no further peak; for a linear array in the half
    circle that it tells from the other"""
    descriptors: FloatArray
    """(4, D) float32, the source-count network's input"""
    fused: FloatArray
    """(A,) the fused spectrum before any removal"""
    field: Field
    findings: Sequence[FoundCandidate]
    """States in which the candidates were found"""

    def directions(self, chosen: Sequence[int]) -> list[float]:
        """Azimuths in radians of the chosen candidates, refined together."""
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
    """The candidates in order, each with the state in which it was found."""
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

    Cells that point to another source would draw the peak towards it and are left out. The others
    count the square root of their attention: attention picks the cells that tell a source from
    none, which are too few for the best direction (docs/training.md, "Where a source is").
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
    """Index of the local maximum uphill from the middle; None where the ascent meets an end."""
    place = len(values) // 2
    while 0 < place < len(values) - 1:
        highest = max((place, place - 1, place + 1), key=values.__getitem__)
        if highest == place:
            return place
        place = highest
    return None
