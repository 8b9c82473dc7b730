"""The sound of fans: tones of the blades and coloured noise of the air.

A robot's cooling fan has the blade-passing frequency and its harmonics, which wander with the
motor's speed, over broadband noise that falls by 6 dB an octave.
"""

from __future__ import annotations

import numpy as np

from model_export import SAMPLE_RATE
from model_export.simulation.noise import colour, unit_power
from service.doa.types import FloatArray

ROTATION = 60.0
"""Hertz; 3600 revolutions a minute"""
BLADES = 5
HARMONICS = 8
HARMONIC_STEP_DB = 4.0
"""Decrease of level from each harmonic to the next"""
WANDER = 0.003
"""Standard deviation of the speed relative to its mean"""
CORNER = 600.0
"""Hertz; above it the air's noise falls by 6 dB an octave"""
LOWEST = 40.0
"""Hertz; lowest frequency that microphones deliver"""


def fan_tones(rng: np.random.Generator, num_samples: int) -> FloatArray:
    """Blade-passing tones (T,) of unit power."""
    seconds = np.arange(num_samples) / SAMPLE_RATE
    knots = np.arange(int(seconds[-1]) + 3) - 0.5
    speed = ROTATION * (1 + WANDER * np.interp(seconds, knots, rng.standard_normal(len(knots))))
    passing = 2 * np.pi * BLADES * np.cumsum(speed) / SAMPLE_RATE
    tones = np.zeros(num_samples)
    for harmonic in range(1, HARMONICS + 1):
        level = 10 ** (-HARMONIC_STEP_DB * (harmonic - 1) / 20)
        tones += level * np.sin(harmonic * passing + rng.uniform(0, 2 * np.pi))
    return tones / tones.std()


def air_noise(rng: np.random.Generator, num_channels: int, num_samples: int) -> FloatArray:
    """Noise (C, T) of flowing air, independent between channels, each of unit power."""
    spectrum = np.fft.rfft(rng.standard_normal((num_channels, num_samples)), axis=-1)
    frequency = np.fft.rfftfreq(num_samples, 1 / SAMPLE_RATE)
    spectrum *= (frequency >= LOWEST) / np.sqrt(1 + (frequency / CORNER) ** 2)
    noise = np.fft.irfft(spectrum, num_samples, axis=-1)
    return noise / noise.std(axis=-1, keepdims=True)


def random_fan(rng: np.random.Generator, num_samples: int) -> FloatArray:
    """A random steady fan (T,) float32 for training; the fan above is left for evaluation."""
    time = np.arange(num_samples) / SAMPLE_RATE
    blades = rng.uniform(60, 400)
    tones = np.zeros(num_samples)
    for harmonic in range(1, 1 + int(rng.integers(2, 12))):
        level = 10 ** (-rng.uniform(0.1, 0.6) * harmonic)
        drift = 0.002 * np.sin(2 * np.pi * rng.uniform(0.1, 1) * time)
        tones += level * np.sin(2 * np.pi * harmonic * blades * (time + drift / blades))
    turbulence = colour(rng, rng.standard_normal((1, num_samples), dtype=np.float32))
    return (unit_power(turbulence)[0] + rng.uniform(0, 2) * tones).astype(np.float32)
