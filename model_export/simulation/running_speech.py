"""Running speech: a word's active part again and again, so that a talker never pauses.

Corpora of words have a silence before and after each of them; a window of half a second would
often hear nothing else.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import FloatArray

FRAME_SAMPLES = 320
"""20 ms at 16 kHz"""
ACTIVE_DB = 25.0
"""Frames this far below the loudest one are silence"""


def running_speech(rng: np.random.Generator, clip: FloatArray, num_samples: int) -> FloatArray:
    """(num_samples,) of one talker who repeats a clip's (T,) word without pauses.

    It begins at a random place of the word.
    """
    word = active_part(clip)
    begin = int(rng.integers(len(word)))
    repeats = -(-(begin + num_samples) // len(word))
    return np.tile(word, repeats)[begin : begin + num_samples]


def active_part(clip: FloatArray) -> FloatArray:
    """A clip (T,) from its first to its last active frame."""
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
    """Mean squares of whole frames; what is left at the end is padded with silence."""
    padded = np.pad(samples, (0, -len(samples) % FRAME_SAMPLES))
    return np.square(padded.reshape(-1, FRAME_SAMPLES), dtype=np.float64).mean(axis=1)
