"""The input and output of a tracker, and the hypothesis of one track: position and existence.

Conventions
-----------
Existence is kept as log-odds in nats, as an integrated probabilistic data association filter has
it: detections add evidence, missed ones take it away. The windows that detections come from
overlap, so consecutive ones repeat each other: evidence and information come in per second of new
audio, not per call. Every constant is in seconds or per second, and results every 20 ms and every
second differ only by what they see.

References
----------
Musicki, Evans, Stankovic, 1994, Integrated probabilistic data association.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from service.doa.kalman import STILL, DirectionFilter, Vector, angles, direction
from service.doa.peaks import wrapped
from service.doa.pose import Rotation


@dataclass(frozen=True, slots=True)
class Detection:
    """One direction that seems to be in a window of audio."""

    azimuth: float
    """Radians, any wrap"""
    confidence: float
    """0 to 1: the chance that a source is within 10 degrees of there"""
    elevation: float | None = None
    """Radians above the horizontal plane; None where only azimuths are heard"""

    @property
    def direction(self) -> Vector:
        """Unit vector."""
        return direction(self.azimuth, self.elevation)

    def turned(self, rotation: Rotation) -> Detection:
        """This detection in another frame."""
        azimuth, elevation = _turned(self, rotation)
        return replace(self, azimuth=azimuth, elevation=elevation)


class Track(NamedTuple):
    """One talker, followed over time."""

    id: int
    """Number from 1; never given twice"""
    azimuth: float
    """Radians in [0, 2 pi)"""
    velocity: float
    """Radians of azimuth per second, counter-clockwise"""
    variance: float
    """Variance of the direction, radians squared"""
    confidence: float
    """0 to 1: the chance that a source is within 10 degrees of there"""
    active: bool
    """True while the talker is heard, False while the track coasts through a pause"""
    born: float
    """Stream time in seconds of its first detection"""
    last_heard: float
    """Stream time in seconds of its last detection"""
    elevation: float | None = None
    """Radians above the horizontal plane; None where only azimuths are heard"""

    @property
    def direction(self) -> Vector:
        """Unit vector."""
        return direction(self.azimuth, self.elevation)

    def turned(self, rotation: Rotation) -> Track:
        """This track in another frame; its velocity is what it was."""
        azimuth, elevation = _turned(self, rotation)
        return self._replace(azimuth=azimuth, elevation=elevation)


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """The constants of tracking; none depends on the rate of results."""

    error: float = math.radians(3.0)
    """Radians, standard deviation of a confident detection's azimuth in a living room"""
    correlation_s: float = 0.25
    """Seconds of audio after which a detection's error is independent: half a window of 0.5 s"""
    spread: float = math.radians(25.0)
    """Radians per second, standard deviation of talkers' velocities: a walk past at 2 m"""
    damping_s: float = 4.0
    """Time constant of the velocity in seconds: people stop and turn"""
    coasting_damping_s: float = 1.0
    """Time constant of the velocity in a pause, seconds: the walk may not go on"""
    fastest: float = math.radians(120.0)
    """Bound on the velocity in radians per second: 1 m/s at half a metre"""
    lag_s: float = 0.3
    """Seconds by which tracks of a moving talker are late: half a window and the filter's delay"""
    lag_spread_s: float = 0.2
    """Seconds, standard deviation of the lag: loud syllables hold a detection back"""
    gate: float = 12.0
    """Largest squared Mahalanobis distance of a detection from its track: 3.5 sigma"""
    alone: float = 16.0
    """Cost of leaving a track without a detection, as a squared distance: more than the gate by the
    log-variance of a track that has coasted long"""
    widest: float = math.radians(30.0)
    """Radians, bound on the gate: further away it is somebody else, whatever the variance"""
    separation: float = math.radians(15.0)
    """Radians within which two may be one talker; the localizer hardly tells closer ones apart"""
    crowding: float = 16.0
    """Factor on the error variance while two tracks pass each other"""
    miss_rate: float = 3.0
    """Nats per second lost in silence: a certain track survives for 2.3 s, a new one for 1.5 s"""
    shadow_rate: float = 1.0
    """Nats per second lost while two tracks pass each other: one may hide the other"""
    passing: float = math.radians(10.0)
    """Radians per second between two near tracks that pass each other; slower ones may not part"""
    most_evidence: float = 4.6
    """Nats, bound on the existence, 99 %: an hour of speech must not outlive minutes of silence"""
    confirmation: float = 2.2
    """Nats, 90 %, at which a track is reported: with less, a fan across a room becomes a track"""
    death: float = -2.2
    """Nats, 10 %, at which a track ends"""
    hold_s: float = 0.35
    """Seconds after its last detection for which a track counts as active, between syllables"""
    merge_s: float = 0.6
    """Seconds without detection after which one of two near tracks is merged into the other"""
    most_tracks: int = 8
    """Most tracks at once, tentative ones included, to bound the cost"""
    memory_s: float = 12.0
    """Seconds of silence after which a talker is forgotten, who else comes back under the old id"""
    memory_speed: float = math.radians(8.0)
    """Radians per second by which a silent talker may have walked"""
    memory_reach: float = math.radians(35.0)
    """Radians, bound on that walk and its errors: further away it is somebody else"""
    most_remembered: int = 16
    """Most silent talkers that are remembered, the latest ones"""


@dataclass(slots=True, eq=False)
class Hypothesis:
    """A track, confirmed or not, with its filter and existence."""

    parameters: TrackerParameters
    filter: DirectionFilter
    evidence: float
    """Log-odds of existence in nats"""
    born: float
    last_heard: float
    last_active: float
    """Stream time in seconds at which the talker was last heard, or hidden while active"""
    level: bool
    """Whether only azimuths are heard"""
    id: int | None = None
    """Id of the track; None until it is confirmed"""

    @classmethod
    def of(cls, parameters: TrackerParameters, detection: Detection, time: float) -> Hypothesis:
        """A track that begins with a detection, ``time`` seconds into the stream."""
        state = DirectionFilter(detection.direction, STILL, 0.0, 0.0, parameters.spread**2)
        # At the beginning of a stream a detection rests on less audio and the onset of noise.
        news = min(1.0, max(time, 0.0) / parameters.correlation_s)
        evidence = min(news * log_odds(detection.confidence), parameters.most_evidence)
        level = detection.elevation is None
        new = cls(parameters, state, evidence, time, time, time, level)
        state.variance = new.error(detection.confidence)
        return new

    def predict(self, duration: float, time: float) -> None:
        """Predict over a duration up to a stream time, both in seconds."""
        p = self.parameters
        coasting = not self.active(time - duration)
        self.filter.predict(duration, p.coasting_damping_s if coasting else p.damping_s, p.spread)

    def error(self, confidence: float) -> float:
        """Error variance of a detection of this track, radians squared.

        Detections of low confidence are further off, up to ten degrees, and late ones by the way
        that the talker has gone since.
        """
        p = self.parameters
        late = p.lag_spread_s * self.filter.speed
        return (p.error / max(confidence, 0.3)) ** 2 + late * late

    def hear(self, detection: Detection, duration: float, time: float, *, passing: bool) -> None:
        """Take in a detection, which may be a neighbour's if the two are ``passing``."""
        p = self.parameters
        news = min(1.0, max(duration, 1e-3) / p.correlation_s)
        variance = self.error(detection.confidence) / news
        # Two talkers that cross are heard as one between them, or as each other. Until they are
        # apart again their velocities are better evidence than detections.
        variance *= p.crowding if passing else 1
        self.filter.correct(detection.direction, variance, p.fastest)
        evidence = self.evidence + news * log_odds(detection.confidence)
        self.evidence = min(evidence, p.most_evidence)
        self.last_heard = self.last_active = time

    def miss(self, duration: float, time: float, *, passing: bool) -> None:
        """Take in a duration without a detection, which a neighbour may have hidden."""
        if passing and self.active(time - duration):
            self.last_active = time
        rate = self.parameters.shadow_rate if passing else self.parameters.miss_rate
        self.evidence -= rate * duration

    def reach(self, begin: float) -> float:
        """Radians within which this talker may go on talking at a stream time in seconds."""
        p = self.parameters
        silence = begin - self.last_heard
        if silence > p.memory_s:
            return 0.0
        return min(p.separation + p.memory_speed * silence, p.memory_reach)

    def succeed(self, other: Hypothesis) -> None:
        """Take over the state of another track of the same talker, under this id."""
        self.filter, self.last_heard = other.filter, other.last_heard
        self.last_active = max(self.last_active, other.last_active)
        self.evidence = max(self.evidence, other.evidence)

    def turn(self, rotation: Rotation) -> None:
        """Turn the direction and the velocity; about z only where nothing but azimuths is heard."""
        turn = Rotation.of_angles(rotation.yaw) if self.level else rotation
        state = self.filter
        state.direction, state.velocity = turn.turn(state.direction), turn.turn(state.velocity)

    def active(self, time: float) -> bool:
        """Whether the talker is heard, or hidden by a neighbour who is."""
        return time - self.last_active <= self.parameters.hold_s

    def track(self, time: float) -> Track:
        """The report of a confirmed track."""
        state = self.filter
        if self.id is None:
            raise ValueError("a track without id is not confirmed")
        # An uncertain velocity counts less: for a standing talker it would only add noise.
        power = state.speed**2
        sure = power / (power + state.velocity_variance)
        azimuth, elevation = angles(state.ahead(self.parameters.lag_s * sure))
        return Track(
            id=self.id,
            azimuth=azimuth,
            velocity=state.turning,
            variance=state.variance,
            confidence=1 / (1 + math.exp(-self.evidence)),
            active=self.active(time),
            born=self.born,
            last_heard=self.last_heard,
            elevation=None if self.level else elevation,
        )


def _turned(one: Detection | Track, rotation: Rotation) -> tuple[float, float | None]:
    """Azimuth and elevation in another frame; about z only where nothing but azimuths is heard."""
    if one.elevation is None:
        return wrapped(one.azimuth + rotation.yaw), None
    return angles(rotation.turn(one.direction))


def log_odds(probability: float) -> float:
    """Log-odds in nats; certainty is bounded at one in a thousand, which no localizer reaches."""
    bounded = min(max(probability, 1e-3), 1 - 1e-3)
    return math.log(bounded / (1 - bounded))
