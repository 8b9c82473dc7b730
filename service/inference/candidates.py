"""Candidate sources by detect-and-remove on block spectra.

Two sources rarely dominate the same time-frequency cell. So the search takes the highest peak of
the fused spectrum, drops the cells that point to it, and fuses the rest again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.fusion import attention_fusion
from service.doa.mirror import into_searched_half
from service.doa.types import FloatArray
from service.inference.descriptors import MOST_TRAINED, NUM_DESCRIPTORS, OF_WINDOW, describe
from service.inference.field import Field, FoundCandidate

Direction = tuple[float, float | None]
"""Azimuth and elevation in radians; no elevation where only azimuths are searched"""
NUM_CANDIDATES = 4
ELSEWHERE_LEVEL = 0.45
"""Spectrum of a cell at another source above which it tells nothing about this direction"""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Up to four candidate directions of one window, in the order in which they were found."""

    directions: Sequence[Direction]
    """Directions as found; for a linear array in the half circle that it tells from the other"""
    descriptors: FloatArray
    """(4, D) float32, the source-count network's input; zeros where there was no further peak, but
    for what candidates share in arrays larger than in training"""
    fused: FloatArray
    """(A,) the fused spectrum of azimuths before any removal"""
    image: FloatArray | None
    """(36, 72) the same on the sphere; None where only azimuths are searched"""
    field: Field
    findings: Sequence[FoundCandidate]
    """States in which the candidates were found"""

    def refined(self, chosen: Sequence[int]) -> list[Direction]:
        """Directions of the chosen candidates, refined together."""
        found = refine(self.field, [self.findings[index] for index in chosen]) if chosen else []
        return into_half(self.field.array, found)


def find_candidates(field: Field) -> Candidates:
    """Detect and remove up to four sources."""
    findings = find_findings(field)
    found = [(finding.azimuth, finding.elevation) for finding in findings]
    descriptors = np.zeros((NUM_CANDIDATES, NUM_DESCRIPTORS), dtype=np.float32)
    if findings:
        descriptors[: len(findings)] = describe(field, findings)
        if field.array.num_microphones > MOST_TRAINED:
            # Many microphones in a dry place find one peak only. In training all four candidates
            # were there but for one window in a thousand, and what they share was never zero.
            descriptors[len(findings) :, OF_WINDOW] = descriptors[0, OF_WINDOW]
        fused = findings[0].fused
    else:
        fused = attention_fusion(field.cells, field.attention)
    return Candidates(
        into_half(field.array, found),
        descriptors,
        field.azimuth_spectrum(fused),
        field.image(fused),
        field,
        findings,
    )


def into_half(array: MicrophoneArray, directions: Sequence[Direction]) -> list[Direction]:
    """Directions with azimuths alone moved into the half circle that a linear array tells."""
    flat = [azimuth for azimuth, elevation in directions if elevation is None]
    if len(flat) < len(directions) or not flat:
        return list(directions)
    return [(azimuth, None) for azimuth in into_searched_half(array, np.array(flat)).tolist()]


def find_findings(field: Field) -> list[FoundCandidate]:
    """The candidates in order, each with the state in which it was found."""
    findings: list[FoundCandidate] = []
    remaining = field.attention
    if not field.total > 0:
        return findings
    while len(findings) < NUM_CANDIDATES and (found := field.find(remaining)) is not None:
        findings.append(found)
        remaining = remaining - found.support
    return findings


def refine(field: Field, sources: Sequence[FoundCandidate]) -> list[Direction]:
    """Directions of the sources, each at the maximum next to where it was found.

    Cells that point to another source would draw the peak towards it and are left out. The others
    count the square root of their attention: attention picks the cells that tell a source from
    none, which are too few for the best direction (docs/training.md, "Where a source is").
    """
    attention = np.sqrt(field.attention)
    pointing = np.array([source.pointing for source in sources])  # (n, C)
    elsewhere = pointing > ELSEWHERE_LEVEL
    of_others = elsewhere.sum(axis=0) > elsewhere
    weights = np.where(of_others, np.float32(0), attention)
    return [field.refined(source, own) for source, own in zip(sources, weights, strict=True)]
