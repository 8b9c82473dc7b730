"""What a tracker takes and gives, and one track's hypothesis: where it is and if it exists.

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
from dataclasses import dataclass

from service.doa.kalman import AzimuthFilter


@dataclass(frozen=True, slots=True)
class Detection:
    """One direction that one window of audio seems to hold."""

    azimuth: float
    """Radians, any wrap"""
    confidence: float
    """Between 0 and 1: about the chance that a source is within 10 degrees"""


@dataclass(frozen=True, slots=True)
class Track:
    """One talker, followed over time."""

    id: int
    """From 1; never given twice"""
    azimuth: float
    """Radians in [0, 2 pi)"""
    velocity: float
    """Radians per second, counter-clockwise"""
    variance: float
    """Of the azimuth, radians squared"""
    confidence: float
    """Probability that the track is a talker, between 0 and 1"""
    active: bool
    """Heard just now; False while the track coasts through a pause"""
    born: float
    """Stream time in seconds of its first detection"""
    last_heard: float
    """Stream time in seconds of its last detection"""


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """The constants of tracking; none depends on how often results come."""

    error: float = math.radians(3.0)
    """Radians, standard deviation of a sure detection's azimuth in a living room"""
    correlation_s: float = 0.25
    """Seconds of new audio that make a detection's error a new one: half a window of 0.5 s"""
    spread: float = math.radians(25.0)
    """Radians per second, standard deviation of talkers' velocities: a walk past at 2 m"""
    damping_s: float = 3.0
    """Seconds in which a talker forgets its velocity: people stop and turn"""
    coasting_damping_s: float = 0.4
    """Seconds, the same in a pause: nothing says that the walk goes on"""
    fastest: float = math.radians(120.0)
    """Radians per second: 1 m/s at half a metre"""
    lag_s: float = 0.15
    """Seconds by which detections of a moving talker are late: their window's middle"""
    gate: float = 9.0
    """Squared Mahalanobis distance up to which a detection may belong to a track: 3 sigma"""
    widest: float = math.radians(30.0)
    """Radians, bound on the same: further away it is somebody else, whatever the variance"""
    separation: float = math.radians(15.0)
    """Radians: what is closer may be one talker; the localizer tells hardly any closer apart"""
    crowding: float = 16.0
    """How much larger the error variance is in the company of another track"""
    hit_gain: float = 1.0
    """Nats that a detection in the gate is worth besides its confidence's log-odds"""
    miss_rate: float = 4.0
    """Nats per second that silence takes: a sure track lives on for 1.7 s, a new one for 0.6 s"""
    shadow_rate: float = 1.0
    """Nats per second, the same of a track whose neighbour was heard: one may hide the other"""
    most_evidence: float = 4.6
    """Nats, bound on the existence, 99 %: an hour of speech must not outlive minutes of silence"""
    confirmation: float = 1.7
    """Nats, 85 %, from which a track is reported"""
    death: float = -2.2
    """Nats, 10 %, at which a track ends"""
    hold_s: float = 0.25
    """Seconds after its last detection that a track still counts as active: between syllables"""
    merge_s: float = 1.5
    """Seconds that two tracks are never heard apart before they are one: crossings are shorter"""
    most_tracks: int = 8
    """Tracks at once, tentative ones included: bounds the cost"""


@dataclass(slots=True, eq=False)
class Hypothesis:
    """A track, confirmed or not, with its filter and existence."""

    parameters: TrackerParameters
    filter: AzimuthFilter
    evidence: float
    """Nats"""
    born: float
    last_heard: float
    last_active: float
    """When it was last heard, or hidden by a neighbour while it was active"""
    id: int | None = None
    """None until it is confirmed"""
    shared_s: float = 0.0
    """Seconds since it and a neighbour were last heard apart"""

    @classmethod
    def of(cls, parameters: TrackerParameters, detection: Detection, time: float) -> Hypothesis:
        """A track that begins with a detection."""
        azimuth = detection.azimuth % (2 * math.pi)
        variance = error_variance(parameters, detection.confidence)
        state = AzimuthFilter(azimuth, 0.0, variance, 0.0, parameters.spread**2)
        evidence = min(log_odds(detection.confidence), parameters.most_evidence)
        return cls(parameters, state, evidence, time, time, time)

    def predict(self, duration: float, time: float) -> None:
        """Move on by a duration up to a stream time, both in seconds."""
        p = self.parameters
        coasting = not self.active(time - duration)
        self.filter.predict(duration, p.coasting_damping_s if coasting else p.damping_s, p.spread)

    def hear(self, detection: Detection, duration: float, time: float, *, crowded: bool) -> None:
        """Take in a detection, ``crowded`` if it may be a neighbour's as well."""
        p = self.parameters
        news = min(1.0, max(duration, 1e-3) / p.correlation_s)
        variance = error_variance(p, detection.confidence) / news * (p.crowding if crowded else 1)
        # Two talkers that cross are heard as one between them, or as each other: until they are
        # apart again their velocities know better than detections.
        self.filter.correct(detection.azimuth, variance, p.fastest)
        gain = p.hit_gain + log_odds(detection.confidence)
        self.evidence = min(self.evidence + news * gain, p.most_evidence)
        self.last_heard = self.last_active = time

    def miss(self, duration: float, time: float, *, shadowed: bool) -> None:
        """Take in that nothing was detected for a duration, perhaps for a neighbour's sake."""
        if shadowed and self.active(time - duration):
            self.last_active = time
        rate = self.parameters.shadow_rate if shadowed else self.parameters.miss_rate
        self.evidence -= rate * duration

    def active(self, time: float) -> bool:
        """Heard just now, or hidden by a neighbour that was."""
        return time - self.last_active <= self.parameters.hold_s

    def track(self, time: float) -> Track:
        """What is reported of a confirmed track."""
        state = self.filter
        if self.id is None:
            raise ValueError("a track without id is not confirmed")
        # Shrunk by how sure the velocity is: of a still talker nothing but noise would be added.
        power = state.velocity * state.velocity
        ahead = self.parameters.lag_s * state.velocity * power / (power + state.velocity_variance)
        return Track(
            id=self.id,
            azimuth=(state.azimuth + ahead) % (2 * math.pi),
            velocity=state.velocity,
            variance=state.azimuth_variance,
            confidence=1 / (1 + math.exp(-self.evidence)),
            active=self.active(time),
            born=self.born,
            last_heard=self.last_heard,
        )


def log_odds(probability: float) -> float:
    """Nats; certainty is bounded at one in a thousand, which no localizer is sure of."""
    bounded = min(max(probability, 1e-3), 1 - 1e-3)
    return math.log(bounded / (1 - bounded))


def error_variance(parameters: TrackerParameters, confidence: float) -> float:
    """Radians squared: unsure detections are further off, up to ten degrees."""
    return (parameters.error / max(confidence, 0.3)) ** 2
