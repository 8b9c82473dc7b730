"""What microphones, converters and firmware do to audio on its way, for training scenes."""

from __future__ import annotations

import numpy as np
import scipy.fft

from model_export import SAMPLE_RATE
from service.doa.types import FloatArray

GAIN_MISMATCH_DB = 1.0
"""Standard deviation of the microphones' gains"""
PHASE_MISMATCH = 4e-6
"""Standard deviation of the microphones' delays in seconds"""
CROSSTALK_DB = (-45.0, -22.0)
BAND_EDGE = (0.4, 0.95)
"""Share of the band that a band limit leaves"""
LEVEL_DBFS = (-60.0, -6.0)
"""Peak level of quantised audio: whispers before distant microphones fill a few bits only"""


def mismatch(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Unequal gains and delays of microphones (N, T)."""
    microphones, samples = audio.shape
    gains = 10 ** (rng.normal(scale=GAIN_MISMATCH_DB, size=(microphones, 1)) / 20)
    delays = rng.normal(scale=PHASE_MISMATCH * rng.random(), size=(microphones, 1))
    frequency = scipy.fft.rfftfreq(samples, 1 / SAMPLE_RATE)
    turn = np.exp(-2j * np.pi * frequency * delays) * gains
    spectrum = scipy.fft.rfft(audio, axis=-1) * turn.astype(np.complex64)
    delayed: FloatArray = scipy.fft.irfft(spectrum, samples, axis=-1).astype(np.float32)
    return delayed


def crosstalk(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """What leaks between neighbouring channels of a converter."""
    leak = np.float32(10 ** (rng.uniform(*CROSSTALK_DB) / 20))
    return audio + leak * np.roll(audio, 1, axis=0)


def band_limit(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """A recording that was once sampled, or coded, for a narrower band."""
    spectrum = scipy.fft.rfft(audio, axis=-1)
    edge = int(spectrum.shape[-1] * rng.uniform(*BAND_EDGE))
    spectrum[:, edge:] *= np.float32(1e-3)
    limited: FloatArray = scipy.fft.irfft(spectrum, audio.shape[-1], axis=-1)
    return limited.astype(np.float32)


def quantised(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """16-bit samples at a low level."""
    level = 10 ** (rng.uniform(*LEVEL_DBFS) / 20) / max(float(np.abs(audio).max()), 1e-9)
    steps: FloatArray = np.round(audio * np.float32(level * 32767))
    return (steps / np.float32(level * 32767)).astype(np.float32)
