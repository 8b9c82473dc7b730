"""Talkers who walk: dry speech through room responses that change along a path.

A response is simulated every two degrees of the path, and the talker fades from each into the
next. The dry speech is faded, not the responses: so the reverberation of every place rings on
after the talker has left, and a still talker sounds as in a static simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model_export import SAMPLE_RATE
from model_export.simulation.noise import sensor_noise
from model_export.simulation.rooms import RESPONSE_SAMPLES, RoomSpec, impulse_responses
from model_export.simulation.running_speech import active_power, mean_power
from model_export.simulation.scenes import convolve
from service.doa.array import MicrophoneArray
from service.doa.steering import unit_vectors
from service.doa.types import BoolArray, FloatArray

STEP = np.deg2rad(2.0)
"""Radians between two responses, 5 cm at 1.5 m"""
VOICED_DB = 20.0
"""A talker pauses while this far below its own active level"""


@dataclass(frozen=True, slots=True)
class Arc:
    """A path around the array at a constant distance, at a constant speed while it goes on."""

    begin: float
    """Azimuth in radians at time 0"""
    velocity: float = 0.0
    """Radians per second, counter-clockwise"""
    distance: float = 1.5
    """Metres from the array's centre"""
    leaves: float = 0.0
    """Seconds at which the walk begins"""
    arrives: float = np.inf
    """Seconds at which it ends"""

    def azimuth(self, time: FloatArray) -> FloatArray:
        """Azimuths in radians in [0, 2 pi) at times in seconds."""
        gone = np.clip(np.asarray(time), self.leaves, self.arrives) - self.leaves
        azimuth: FloatArray = (self.begin + self.velocity * gone) % (2 * np.pi)
        return azimuth

    def knots(self, duration: float) -> FloatArray:
        """Seconds (S,) at which a response is simulated, at most ``STEP`` of the way apart."""
        begin, end = min(self.leaves, duration), min(self.arrives, duration)
        turn = abs(self.velocity) * (end - begin)
        return np.linspace(begin, end, 2 + int(turn / STEP)) if turn else np.zeros(1)


@dataclass(frozen=True, slots=True)
class Talker:
    """Somebody who talks while walking along a path."""

    path: Arc
    speech: FloatArray
    """(T,) dry speech of any level"""

    def voiced(self, time: float, duration: float) -> bool:
        """Whether the talker talks in the ``duration`` seconds before a time."""
        end = round(time * SAMPLE_RATE)
        heard = self.speech[max(0, end - round(duration * SAMPLE_RATE)) : end]
        threshold = 10 ** (-VOICED_DB / 10) * active_power(self.speech)
        return len(heard) > 0 and mean_power(heard) >= threshold


@dataclass(frozen=True, slots=True)
class MovingScene:
    """Audio and its talkers."""

    audio: FloatArray
    """(N, T) float32"""
    talkers: tuple[Talker, ...]

    def azimuths(self, time: float) -> FloatArray:
        """Azimuths (M,) of the talkers in radians at a time in seconds."""
        return np.array([float(t.path.azimuth(np.array(time))) for t in self.talkers])

    def voiced(self, time: float, duration: float) -> BoolArray:
        """Whether each talker (M,) talks in the ``duration`` seconds before a time."""
        return np.array([t.voiced(time, duration) for t in self.talkers], dtype=bool)


def simulate_moving(
    rng: np.random.Generator,
    room: RoomSpec,
    array: MicrophoneArray,
    talkers: Sequence[Talker],
    *,
    snr_db: float,
) -> MovingScene:
    """Simulate talkers of equal active level at the first microphone, in white sensor noise.

    The noise power is the power of one talker's active level, less the SNR.
    """
    num_samples = max(len(talker.speech) for talker in talkers)
    audio = np.zeros((array.num_microphones, num_samples))
    for talker in talkers:
        wet = walk(room, array, talker)
        audio[:, : wet.shape[1]] += wet / np.sqrt(active_power(wet[0]))
    audio += 10 ** (-snr_db / 20) * sensor_noise(rng, audio.shape)
    return MovingScene(audio.astype(np.float32), tuple(talkers))


def walk(room: RoomSpec, array: MicrophoneArray, talker: Talker) -> FloatArray:
    """Microphone signals (N, T) of one talker, not rescaled after the room."""
    path, num_samples = talker.path, len(talker.speech)
    times = path.knots(num_samples / SAMPLE_RATE)
    knots, places = times * SAMPLE_RATE, path.distance * unit_vectors(path.azimuth(times))
    responses = impulse_responses(room, array.positions, places, longest=RESPONSE_SAMPLES)
    return convolve_moving(talker.speech, responses, knots)


def convolve_moving(dry: FloatArray, responses: FloatArray, knots: FloatArray) -> FloatArray:
    """Convolve dry speech (T,) with responses that fade into each other: (N, T).

    Parameters
    ----------
    dry : (T,) float
    responses : (S, N, K) float
    knots : (S,) float
        Samples at which each response holds alone, ascending. The first holds before its knot, the
        last after its own.
    """
    num_samples = len(dry)
    wet = np.zeros((responses.shape[1], num_samples), dtype=np.float32)
    indices = np.arange(num_samples)
    for place, response in enumerate(responses):
        hat = np.zeros(len(knots))
        hat[place] = 1.0
        begin = 0 if place == 0 else int(knots[place - 1])
        end = num_samples if place == len(knots) - 1 else int(np.ceil(knots[place + 1]))
        part = dry[begin:end] * np.interp(indices[begin:end], knots, hat)
        sound = convolve(part, response)[:, : num_samples - begin]
        wet[:, begin : begin + sound.shape[1]] += sound
    return wet
