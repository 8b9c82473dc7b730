"""Multi-source tracking on the sphere: from detections of successive windows to talkers with ids.

Task: an unknown number of talkers start, pause, move, cross and stop. The localizer reports
directions for every window of audio, misses some and invents some.

Conventions
-----------
Directions are unit vectors, on the horizon where only azimuths are heard; angles between them are
great-circle angles in radians; time is in seconds of the stream. Every update predicts all tracks,
assigns detections to them by the least total distance, lets unassigned detections begin new ones
and ends those without evidence. A track is reported from the update in which its existence is
confirmed: a confident detection confirms it at once, others when they repeat. A talker who goes on
after a long silence near the old place gets the old id.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from service.doa.kalman import angle
from service.doa.pose import Rotation
from service.doa.track import Detection, Hypothesis, Track, TrackerParameters

__all__ = ["Detection", "Track", "Tracker", "TrackerParameters"]


class Tracker:
    """Follows talkers through one stream; an update takes some 0.03 ms."""

    def __init__(self, parameters: TrackerParameters | None = None) -> None:
        # The import is here: it would double the service's start, and must not delay an update.
        from scipy.optimize import linear_sum_assignment

        self._solve = linear_sum_assignment
        self._parameters = parameters or TrackerParameters()
        self._last_id = 0
        self._time: float | None = None
        self._hypotheses: list[Hypothesis] = []
        self._remembered: list[Hypothesis] = []

    def reset(self) -> None:
        """Forget all tracks and the time; ids continue, so that none is given twice."""
        self._hypotheses = []
        self._remembered = []
        self._time = None

    def turn(self, rotation: Rotation) -> None:
        """Turn all tracks: their directions are told in another frame from now on."""
        for hypothesis in (*self._hypotheses, *self._remembered):
            hypothesis.turn(rotation)

    def update(self, detections: Sequence[Detection], time: float) -> tuple[Track, ...]:
        """Take in the detections of one window.

        Parameters
        ----------
        detections : sequence of Detection
            Detections in any order; none where nothing sounds.
        time : float
            Seconds since the stream began; after a gap the tracks are predicted further.

        Returns
        -------
        tracks : tuple of Track
            Confirmed tracks, oldest id first.

        Raises
        ------
        ValueError
            If the time goes backwards or anything is not finite.
        """
        ordered = _ordered(detections)
        duration = self._advance(time)
        pairs = self._assign(ordered)
        passing = [self._passing(hypothesis) for hypothesis in self._hypotheses]
        for index, hypothesis in enumerate(self._hypotheses):
            if index in pairs:
                detection = ordered[pairs[index]]
                hypothesis.hear(detection, duration, time, passing=passing[index])
            else:
                hypothesis.miss(duration, time, passing=passing[index])
        self._merge(time)
        free = [d for i, d in enumerate(ordered) if i not in set(pairs.values())]
        self._bury(time)
        self._begin(free, time)
        return self._confirmed(time)

    def _advance(self, time: float) -> float:
        """Predict all tracks up to a time; return the seconds since the last one."""
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
        """The detection of every track that has one, both as list indices."""
        if not (self._hypotheses and detections):
            return {}
        p = self._parameters
        costs = [[self._cost(h, d) for d in detections] for h in self._hypotheses]
        rows, columns = self._solve(np.array(costs))
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return {row: column for row, column in pairs if costs[row][column] < p.alone}

    def _cost(self, hypothesis: Hypothesis, detection: Detection) -> float:
        """Twice the negative log-likelihood up to a constant, or the cost of being alone."""
        p = self._parameters
        off = angle(detection.direction, hypothesis.filter.direction)
        if off > p.widest:
            return p.alone
        variance = hypothesis.error(detection.confidence)
        distance = hypothesis.filter.distance(detection.direction, variance)
        # A close detection must not begin a track of its own, however certain this position is.
        if distance > p.gate and off > p.separation:
            return p.alone
        width = math.log(1 + hypothesis.filter.variance / variance)
        # A tentative track must not take the detection of a confirmed one beside it.
        handicap = 0.0 if hypothesis.id is not None else p.gate / 4
        return min(distance, p.gate) + width + handicap

    def _near(self, one: Hypothesis, other: Hypothesis) -> bool:
        off = angle(one.filter.direction, other.filter.direction)
        return off < self._parameters.separation

    def _in_wake(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether two may be one talker, heard here and where it was some syllables ago."""
        p = self._parameters
        off = angle(one.filter.direction, other.filter.direction)
        fastest = max(one.filter.speed, other.filter.speed)
        return off < p.separation + p.lag_s * fastest

    def _part(self, one: Hypothesis, other: Hypothesis) -> bool:
        """Whether their velocities take two tracks through or from each other."""
        return one.filter.relative_speed(other.filter) > self._parameters.passing

    def _passing(self, hypothesis: Hypothesis) -> bool:
        """Whether a track is passing another one, so that they may be heard as one."""
        return any(
            other is not hypothesis
            and other.id is not None
            and self._near(hypothesis, other)
            and self._part(hypothesis, other)
            for other in self._hypotheses
        )

    def _merge(self, time: float) -> None:
        """Merge two near tracks of which one is not heard; the older id stays."""
        p = self._parameters
        confirmed = [h for h in self._hypotheses if h.id is not None]
        confirmed.sort(key=lambda h: h.id or 0)
        for place, older in enumerate(confirmed):
            for younger in confirmed[place + 1 :]:
                silent = time - min(older.last_heard, younger.last_heard)
                if silent < p.merge_s or not self._in_wake(older, younger):
                    continue
                if self._part(older, younger) or younger.evidence == -math.inf:
                    continue
                if younger.last_heard > older.last_heard:
                    older.succeed(younger)
                younger.evidence = -math.inf

    def _bury(self, time: float) -> None:
        """End tracks without evidence; remember the talkers among them for a while."""
        p = self._parameters
        dead = [h for h in self._hypotheses if h.evidence <= p.death]
        self._hypotheses = [h for h in self._hypotheses if h.evidence > p.death]
        self._remembered += [h for h in dead if h.id is not None and h.evidence > -math.inf]
        recent = [h for h in self._remembered if time - h.last_heard <= p.memory_s]
        self._remembered = recent[-p.most_remembered :]

    def _begin(self, detections: Sequence[Detection], time: float) -> None:
        """Begin tracks from unassigned detections, most confident first."""
        p = self._parameters
        for detection in detections:
            new = Hypothesis.of(p, detection, time)
            if any(self._in_wake(h, new) for h in self._hypotheses) or new.evidence <= p.death:
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
                self._name(hypothesis)
        tracks = [h.track(time) for h in self._hypotheses if h.id is not None]
        return tuple(sorted(tracks, key=lambda track: track.id))

    def _name(self, hypothesis: Hypothesis) -> None:
        """Give a confirmed track its id: that of the silent talker it continues, or a new one."""
        place, begin = hypothesis.filter.direction, hypothesis.born
        ways = [(angle(place, h.filter.direction), h) for h in self._remembered]
        near = [(way, h) for way, h in ways if way < h.reach(begin)]
        if not near:
            self._last_id += 1
            hypothesis.id = self._last_id
            return
        _, silent = min(near, key=lambda pair: pair[0])
        self._remembered.remove(silent)
        hypothesis.id, hypothesis.born = silent.id, silent.born


def _ordered(detections: Sequence[Detection]) -> list[Detection]:
    """Detections, most confident first, whatever their order."""
    for detection in detections:
        angles = (detection.azimuth, detection.elevation or 0.0)
        if not (all(map(math.isfinite, angles)) and 0 <= detection.confidence <= 1):
            raise ValueError(f"a detection needs finite radians and a confidence, not {detection}")
    return sorted(detections, key=lambda d: (-d.confidence, d.azimuth))
