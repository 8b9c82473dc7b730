"""HOTA: how well tracks find talkers, and how well their ids stay with them, in one number.

A pair of a talker and a track is as similar as its error is small: 1 at 0 degrees, 0 at
``CUTOFF``. For every least similarity, detection is the share of pairs among all talkers and
tracks, association the share of moments that a pair's talker and track have in common, averaged
over the pairs; HOTA is the mean of their geometric means.

References
----------
Luiten et al., 2021, HOTA: a higher order metric for evaluating multi-object tracking.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.doa.scoring import OSPA_CUTOFF as CUTOFF
from service.doa.scoring import circular_error
from service.doa.types import FloatArray

LEAST = np.arange(1, 20) / 20
"""Least similarities that a pair must have"""


@dataclass(frozen=True, slots=True)
class Moment:
    """Who talks and what is reported at one update."""

    talkers: Sequence[int]
    azimuth: FloatArray
    """(M,) radians, of the talkers"""
    tracks: Sequence[int]
    """Ids"""
    reported: FloatArray
    """(T,) radians, of the tracks"""

    def similarity(self) -> FloatArray:
        """(M, T), 0 to 1."""
        error = circular_error(self.azimuth[:, None], self.reported[None])
        return np.maximum(1 - error / CUTOFF, 0.0)


def hota(moments: Sequence[Moment]) -> float:
    """HOTA of one stream, 0 to 1; 1 where nobody talks and nothing is reported."""
    talking = Counter(talker for moment in moments for talker in moment.talkers)
    reported = Counter(track for moment in moments for track in moment.tracks)
    if not talking and not reported:
        return 1.0
    similarities = [moment.similarity() for moment in moments]
    together: defaultdict[tuple[int, int], float] = defaultdict(float)
    for moment, similarity in zip(moments, similarities, strict=True):
        for row, talker in enumerate(moment.talkers):
            for column, track in enumerate(moment.tracks):
                together[talker, track] += float(similarity[row, column])
    scores = []
    for least in LEAST:
        pairs = [
            pair
            for moment, similarity in zip(moments, similarities, strict=True)
            for pair in _pairs(moment, similarity, together, talking, reported, float(least))
        ]
        common = Counter(pairs)
        detection = len(pairs) / (talking.total() + reported.total() - len(pairs))
        associations = [
            common[pair] / (talking[pair[0]] + reported[pair[1]] - common[pair]) for pair in pairs
        ]
        association = float(np.mean(associations)) if associations else 0.0
        scores.append(np.sqrt(detection * association))
    return float(np.mean(scores))


def _pairs(
    moment: Moment,
    similarity: FloatArray,
    together: Mapping[tuple[int, int], float],
    talking: Counter[int],
    reported: Counter[int],
    least: float,
) -> list[tuple[int, int]]:
    """Pairs of one moment; those that belong together over the whole stream go first."""
    if not similarity.size:
        return []
    alignment = np.array(
        [
            [
                together[talker, track]
                / (talking[talker] + reported[track] - together[talker, track])
                for track in moment.tracks
            ]
            for talker in moment.talkers
        ]
    )
    allowed = similarity >= least
    rows, columns = linear_sum_assignment(
        np.where(allowed, alignment + 1e-6 * similarity, 0.0), maximize=True
    )
    return [
        (moment.talkers[row], moment.tracks[column])
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if allowed[row, column]
    ]
