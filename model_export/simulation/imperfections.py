"""Imperfections of microphones, converters and firmware, for training scenes."""

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
"""Range of the level of a neighbouring channel's leak"""
BAND_EDGE = (0.4, 0.95)
"""Range of the share of the band that a band limit leaves"""
LEVEL_DBFS = (-60.0, -6.0)
"""Range of the peak level of quantised audio; a distant whisper fills only a few bits"""


def mismatch(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Give the microphones of audio (N, T) unequal gains and delays."""
    microphones, samples = audio.shape
    gains = 10 ** (rng.normal(scale=GAIN_MISMATCH_DB, size=(microphones, 1)) / 20)
    delays = rng.normal(scale=PHASE_MISMATCH * rng.random(), size=(microphones, 1))
    frequency = scipy.fft.rfftfreq(samples, 1 / SAMPLE_RATE)
    turn = np.exp(-2j * np.pi * frequency * delays) * gains
    spectrum = scipy.fft.rfft(audio, axis=-1) * turn.astype(np.complex64)
    delayed: FloatArray = scipy.fft.irfft(spectrum, samples, axis=-1).astype(np.float32)
    return delayed


def crosstalk(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Add the leak between neighbouring channels of a converter to audio (N, T)."""
    leak = np.float32(10 ** (rng.uniform(*CROSSTALK_DB) / 20))
    return audio + leak * np.roll(audio, 1, axis=0)


def band_limit(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Limit audio (N, T) to a narrower band, as a lower sample rate or a codec does."""
    spectrum = scipy.fft.rfft(audio, axis=-1)
    edge = int(spectrum.shape[-1] * rng.uniform(*BAND_EDGE))
    spectrum[:, edge:] *= np.float32(1e-3)
    limited: FloatArray = scipy.fft.irfft(spectrum, audio.shape[-1], axis=-1)
    return limited.astype(np.float32)


def quantised(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Round audio (N, T) to 16-bit samples at a low level; its scale stays."""
    level = 10 ** (rng.uniform(*LEVEL_DBFS) / 20) / max(float(np.abs(audio).max()), 1e-9)
    steps: FloatArray = np.round(audio * np.float32(level * 32767))
    return (steps / np.float32(level * 32767)).astype(np.float32)
