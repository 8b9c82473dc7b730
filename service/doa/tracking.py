"""Multi-source tracking on the circle: detections of successive windows to talkers with ids.

Task: an unknown number of talkers start, pause, move, cross and stop; the localizer reports some
directions for every window of audio, misses some and invents some.

Conventions
-----------
Azimuths in radians, time in seconds of the stream. Every update predicts all tracks, assigns
detections to them by the least total distance, lets unassigned detections begin new ones and ends
those that nothing speaks for any more. A track is reported from the update in which its existence
is confirmed: a sure detection confirms at once, unsure ones when they repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from service.doa.peaks import circular_difference
from service.doa.track import (
    Detection,
    Hypothesis,
    Track,
    TrackerParameters,
    error_variance,
)

__all__ = ["Detection", "Track", "Tracker", "TrackerParameters"]


class Tracker:
    """Follows talkers through one stream; about 0.1 ms an update."""

    def __init__(self, parameters: TrackerParameters | None = None) -> None:
        # Imported here: half of the service's start, but not of the first update's time.
        from scipy.optimize import linear_sum_assignment

        self._solve = linear_sum_assignment
        self._parameters = parameters or TrackerParameters()
        self._last_id = 0
        self._time: float | None = None
        self._hypotheses: list[Hypothesis] = []

    def reset(self) -> None:
        """Forget all tracks and the time; ids go on, so that none is ever given twice."""
        self._hypotheses = []
        self._time = None

    def update(self, detections: Sequence[Detection], time: float) -> tuple[Track, ...]:
        """Take in the detections of one window.

        Parameters
        ----------
        detections : sequence of Detection
            In any order; none where nothing sounds.
        time : float
            Stream time in seconds; after a gap the tracks are predicted further.

        Returns
        -------
        tracks : tuple of Track
            The confirmed ones, oldest id first.

        Raises
        ------
        ValueError
            If the time goes backwards or anything is not finite.
        """
        duration = self._advance(time)
        ordered = _ordered(detections)
        pairs = self._assign(ordered)
        heard = set(pairs)
        for index, hypothesis in enumerate(self._hypotheses):
            near = self._neighbours(index)
            if index in pairs:
                shared = any(n not in heard for n in near)
                hypothesis.hear(ordered[pairs[index]], duration, time, crowded=bool(near))
                apart = not shared
            else:
                shadowed = hypothesis.id is not None and any(n in heard for n in near)
                hypothesis.miss(duration, time, shadowed=shadowed)
                apart = not shadowed
            hypothesis.shared_s = 0.0 if apart else hypothesis.shared_s + duration
        self._merge(heard)
        free = [d for i, d in enumerate(ordered) if i not in set(pairs.values())]
        self._bury()
        self._begin(free, time)
        return self._confirmed(time)

    def _advance(self, time: float) -> float:
        """Predict all tracks up to a time; the seconds since the last one."""
        if not math.isfinite(time):
            raise ValueError(f"the stream's time must be finite seconds, not {time!r}")
        duration = 0.0 if self._time is None else time - self._time
        if duration < 0:
            raise ValueError(
                f"the stream's time goes backwards, from {self._time:g} s to {time:g} s: call "
                "reset() before another stream"
            )
        self._time = time
        for hypothesis in self._hypotheses:
            hypothesis.predict(duration, time)
        return duration

    def _assign(self, detections: Sequence[Detection]) -> dict[int, int]:
        """Detection of every track that has one, by their places in the lists."""
        if not (self._hypotheses and detections):
            return {}
        p = self._parameters
        costs = [[self._cost(h, d) for d in detections] for h in self._hypotheses]
        rows, columns = self._solve(np.array(costs))
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return {row: column for row, column in pairs if costs[row][column] < p.gate}

    def _cost(self, hypothesis: Hypothesis, detection: Detection) -> float:
        """Squared distance, or the gate's bound: as much as not to assign the two."""
        p = self._parameters
        off = abs(circular_difference(detection.azimuth, hypothesis.filter.azimuth))
        if off > p.widest:
            return p.gate
        variance = error_variance(p, detection.confidence)
        # A tentative track must not take the detection of a confirmed one beside it.
        handicap = 0.0 if hypothesis.id is not None else p.gate / 4
        cost = min(hypothesis.filter.distance(detection.azimuth, variance) + handicap, p.gate)
        # Whatever is this close can begin no track of its own.
        return min(cost, 0.99 * p.gate) if off < p.separation else cost

    def _neighbours(self, index: int) -> list[int]:
        """Places of the confirmed tracks that may be heard as one with this one."""
        here = self._hypotheses[index].filter.azimuth
        return [
            other
            for other, hypothesis in enumerate(self._hypotheses)
            if other != index
            and hypothesis.id is not None
            and abs(circular_difference(hypothesis.filter.azimuth, here))
            < self._parameters.separation
        ]

    def _merge(self, heard: set[int]) -> None:
        """Make one of two tracks that have long not been heard apart; the older id stays."""
        p = self._parameters
        for index, younger in reversed(list(enumerate(self._hypotheses))):
            if younger.id is None or younger.shared_s < p.merge_s:
                continue
            for other in self._neighbours(index):
                older = self._hypotheses[other]
                if older.id is not None and older.id < younger.id and older.shared_s >= p.merge_s:
                    if index in heard:
                        older.filter = younger.filter
                        older.evidence = max(older.evidence, younger.evidence)
                        older.last_heard = older.last_active = younger.last_heard
                    older.shared_s = 0.0
                    younger.evidence = -math.inf
                    break

    def _bury(self) -> None:
        self._hypotheses = [h for h in self._hypotheses if h.evidence > self._parameters.death]

    def _begin(self, detections: Sequence[Detection], time: float) -> None:
        """New tracks of the detections that belong to none, the surest first."""
        p = self._parameters
        for detection in detections:
            new = Hypothesis.of(p, detection, time)
            beside = any(
                abs(circular_difference(h.filter.azimuth, new.filter.azimuth)) < p.separation
                for h in self._hypotheses
            )
            if beside or new.evidence <= p.death:
                continue
            if len(self._hypotheses) == p.most_tracks:
                weakest = min(self._hypotheses, key=lambda h: (h.id is not None, h.evidence))
                if weakest.id is not None or weakest.evidence >= new.evidence:
                    continue
                self._hypotheses.remove(weakest)
            self._hypotheses.append(new)

    def _confirmed(self, time: float) -> tuple[Track, ...]:
        for hypothesis in self._hypotheses:
            if hypothesis.id is None and hypothesis.evidence >= self._parameters.confirmation:
                self._last_id += 1
                hypothesis.id = self._last_id
        tracks = [h.track(time) for h in self._hypotheses if h.id is not None]
        return tuple(sorted(tracks, key=lambda track: track.id))


def _ordered(detections: Sequence[Detection]) -> list[Detection]:
    """The surest first, whatever order they come in."""
    for detection in detections:
        if not (math.isfinite(detection.azimuth) and 0 <= detection.confidence <= 1):
            raise ValueError(f"a detection needs finite radians and a confidence, not {detection}")
    return sorted(detections, key=lambda d: (-d.confidence, d.azimuth))
