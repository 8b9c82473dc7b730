"""Scores of estimated directions against the truth.

Task: a method reports directions for a window in which some sources sound.

Conventions
-----------
Azimuths in radians, any wrap. Estimates and truths are unordered; all scores match them by the
assignment with the least total circular error.

Scores
------
circular_error : distance on the circle.
match : optimal assignment.
maae : mean absolute angular error of matched pairs.
f1 : hits within a tolerance against misses and false alarms.
ospa : one number for position and cardinality errors.
count_accuracy : share of windows whose number of sources is right.
evaluate : these and three shares: windows whose first estimate is within 10 degrees of a source,
    sources without an estimate within 10 degrees, windows without any estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.sphere import angle_between
from service.doa.types import FloatArray, IntArray

OSPA_CUTOFF = np.deg2rad(30.0)


def validate(azimuths: FloatArray) -> FloatArray:
    """The azimuths as a finite (M,) float64 array, or ValueError."""
    values = np.atleast_1d(np.asarray(azimuths, dtype=np.float64))
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError(f"azimuths must be a list of finite radians, not {azimuths!r}")
    return values


def circular_error(first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance on the circle in radians, in [0, pi], with broadcasting."""
    difference = np.asarray(first, dtype=np.float64) - second
    error: FloatArray = np.abs((difference + np.pi) % (2 * np.pi) - np.pi)
    return error


def match(estimated: FloatArray, truth: FloatArray) -> list[tuple[int, int, float]]:
    """Pairs (estimate, truth, error in radians) of the least total error; min(M, M') of them."""
    estimated, truth = validate(estimated), validate(truth)
    return _pairs(circular_error(estimated[:, None], truth[None]))


def match_directions(estimated: FloatArray, truth: FloatArray) -> list[tuple[int, int, float]]:
    """The same for unit vectors (M', 3) and (M, 3); errors are great-circle angles."""
    return _pairs(angle_between(estimated[:, None], truth[None]))


def _pairs(errors: FloatArray) -> list[tuple[int, int, float]]:
    rows, columns = _assign(errors)
    return [(int(r), int(c), float(errors[r, c])) for r, c in zip(rows, columns, strict=True)]


def maae(estimated: FloatArray, truth: FloatArray) -> float:
    """Mean absolute angular error in radians over the matched pairs; missing estimates count pi/2.

    Half of pi is what a random guess scores on average, so leaving a source out gains nothing.
    """
    truth = validate(truth)
    if truth.size == 0:
        raise ValueError("the angular error of a window without sources is not defined")
    errors = [error for _, _, error in match(estimated, truth)]
    return float((sum(errors) + (truth.size - len(errors)) * np.pi / 2) / truth.size)


@dataclass(frozen=True, slots=True)
class DetectionCounts:
    """Hits, false alarms and misses; add them up over windows before taking rates."""

    hits: int
    false_alarms: int
    misses: int

    def __add__(self, other: DetectionCounts) -> DetectionCounts:
        return DetectionCounts(
            self.hits + other.hits,
            self.false_alarms + other.false_alarms,
            self.misses + other.misses,
        )

    @property
    def f1(self) -> float:
        """2 hits / (2 hits + false alarms + misses); 1 where there was nothing to find."""
        total = 2 * self.hits + self.false_alarms + self.misses
        return 2 * self.hits / total if total else 1.0


def detection(estimated: FloatArray, truth: FloatArray, tolerance: float) -> DetectionCounts:
    """Count a window's hits: matched pairs within ``tolerance`` radians."""
    estimated, truth = validate(estimated), validate(truth)
    hits = sum(error <= tolerance for _, _, error in match(estimated, truth))
    return DetectionCounts(hits, estimated.size - hits, truth.size - hits)


def _assign(costs: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the assignment with the least total cost."""
    # The import is here because the service scores nothing and would start twice as slowly.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(costs)
    return rows, columns


def ospa(
    estimated: FloatArray, truth: FloatArray, *, cutoff: float = OSPA_CUTOFF, order: float = 1.0
) -> float:
    """Optimal sub-pattern assignment distance in radians, in [0, cutoff].

    References
    ----------
    Schuhmacher, Vo, Vo, 2008, A consistent metric for performance evaluation of multi-object
    filters, eq. (3).
    """
    estimated, truth = validate(estimated), validate(truth)
    larger = max(estimated.size, truth.size)
    if larger == 0:
        return 0.0
    errors = np.minimum(circular_error(estimated[:, None], truth[None]), cutoff) ** order
    rows, columns = _assign(errors)
    unmatched = cutoff**order * abs(estimated.size - truth.size)
    return float(((errors[rows, columns].sum() + unmatched) / larger) ** (1 / order))


def count_accuracy(estimated: Sequence[int], truth: Sequence[int]) -> float:
    """Share of windows whose number of sources is right."""
    if len(estimated) != len(truth) or not truth:
        raise ValueError("count_accuracy needs one estimate per window and at least one window")
    return float(np.mean(np.asarray(estimated) == np.asarray(truth)))


def evaluate(estimated: Sequence[FloatArray], truth: Sequence[FloatArray]) -> dict[str, float]:
    """All scores over windows; angles are in degrees, as tables show them.

    A window's first estimate is its method's most confident one.
    """
    pairs = list(zip(estimated, truth, strict=True))
    sounding = [(e, t) for e, t in pairs if len(t)]
    errors = [maae(e, t) for e, t in sounding]
    detections = {tolerance: _total(pairs, tolerance) for tolerance in (5, 10, 20)}
    talkers = sum(len(t) for _, t in pairs)
    return {
        "maae_deg": float(np.rad2deg(np.mean(errors))),
        "median_error_deg": float(np.rad2deg(np.median(errors))),
        "ospa_deg": float(np.rad2deg(np.mean([ospa(e, t) for e, t in pairs]))),
        "count_accuracy": count_accuracy([len(e) for e, _ in pairs], [len(t) for _, t in pairs]),
        **{f"f1_{tolerance}deg": total.f1 for tolerance, total in detections.items()},
        "within_10deg": float(np.mean([_first_within(e, t, 10) for e, t in sounding])),
        "missed_talkers": detections[10].misses / talkers,
        "unanswered": float(np.mean([len(e) == 0 for e, _ in sounding])),
    }


def _total(pairs: Sequence[tuple[FloatArray, FloatArray]], tolerance_deg: float) -> DetectionCounts:
    tolerance = float(np.deg2rad(tolerance_deg))
    return sum((detection(e, t, tolerance) for e, t in pairs), DetectionCounts(0, 0, 0))


def _first_within(estimated: FloatArray, truth: FloatArray, tolerance_deg: float) -> bool:
    if len(estimated) == 0:
        return False
    return bool(circular_error(estimated[0], truth).min() <= np.deg2rad(tolerance_deg))
