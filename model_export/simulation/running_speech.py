"""Running speech: a word's active part repeated, so that a talker never pauses.

Words of a corpus begin and end with silence; a window of half a second would often hold nothing
else.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import FloatArray

FRAME_SAMPLES = 320
"""Frame of 20 ms at 16 kHz"""
ACTIVE_DB = 25.0
"""Silence is this far below the loudest frame, or farther"""


def running_speech(rng: np.random.Generator, clip: FloatArray, num_samples: int) -> FloatArray:
    """Speech (num_samples,) of one talker who repeats a clip's (T,) word without pauses.

    It starts at a random sample of the word.
    """
    word = active_part(clip)
    begin = int(rng.integers(len(word)))
    repeats = -(-(begin + num_samples) // len(word))
    return np.tile(word, repeats)[begin : begin + num_samples]


def active_part(clip: FloatArray) -> FloatArray:
    """The clip (T,) cut to its first to last active frame."""
    frames = np.flatnonzero(_active(_frame_powers(clip)))
    return clip[frames[0] * FRAME_SAMPLES : (frames[-1] + 1) * FRAME_SAMPLES]


def active_power(speech: FloatArray) -> float:
    """Mean square of speech (T,) over its active frames: its active level, squared."""
    powers = _frame_powers(speech)
    return float(powers[_active(powers)].mean())


def mean_power(samples: FloatArray) -> float:
    """Mean square of (T,) samples."""
    return float(np.mean(np.square(samples, dtype=np.float64)))


def _active(powers: FloatArray) -> FloatArray:
    return powers >= 10 ** (-ACTIVE_DB / 10) * powers.max()


def _frame_powers(samples: FloatArray) -> FloatArray:
    """Mean squares of the frames; the last one is padded with silence."""
    padded = np.pad(samples, (0, -len(samples) % FRAME_SAMPLES))
    return np.square(padded.reshape(-1, FRAME_SAMPLES), dtype=np.float64).mean(axis=1)
