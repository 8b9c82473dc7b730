"""Synthetic speech: voiced and unvoiced syllables from a glottal pulse train through formants.

It needs no corpus, so its sounds may be committed: the sample recording, the golden inputs of
bundles and the tests are made of it. It has the features of speech that localization needs:
pauses, onsets, harmonics and a spectrum from 100 Hz to 7 kHz.
"""

from __future__ import annotations

import numpy as np
import scipy.signal

from model_export import SAMPLE_RATE
from service.doa.types import FloatArray

VOWELS = (
    (730, 1090, 2440),
    (530, 1840, 2480),
    (270, 2290, 3010),
    (570, 840, 2410),
    (440, 1020, 2240),
)
"""Formants in hertz of five vowels (Peterson and Barney, 1952)"""


def synthetic_voice(rng: np.random.Generator, seconds: float) -> FloatArray:
    """Wordless speech (T,) float32 with a peak of 1."""
    pitch = rng.uniform(90, 230)
    pieces: list[FloatArray] = []
    length = 0
    while length < seconds * SAMPLE_RATE:
        pieces.append(_syllable(rng, pitch))
        pause = rng.uniform(0.02, 0.08) if rng.random() < 0.8 else rng.uniform(0.15, 0.3)
        pieces.append(np.zeros(int(pause * SAMPLE_RATE)))
        length += pieces[-2].size + pieces[-1].size
    voice = np.concatenate(pieces)[: int(seconds * SAMPLE_RATE)]
    scaled: FloatArray = (voice / np.abs(voice).max()).astype(np.float32)
    return scaled


def sound_bursts(rng: np.random.Generator, seconds: float) -> FloatArray:
    """Bursts (T,) float32 of noise or pulses: sounds that are no speech."""
    samples = int(seconds * SAMPLE_RATE)
    pulses = np.diff(np.floor(np.arange(samples) * rng.uniform(80, 400) / SAMPLE_RATE), prepend=0)
    share = rng.choice([0.0, 1.0, rng.random()])
    sound = share * pulses * np.sqrt(samples / max(pulses.sum(), 1))
    sound = sound + (1.03 - share) * rng.standard_normal(samples)
    time = np.arange(samples) / SAMPLE_RATE
    envelope = np.sin(np.pi * rng.uniform(2, 7) * time + rng.uniform(0, np.pi)) ** 2
    bursts = sound * envelope ** rng.uniform(0.5, 3)
    scaled: FloatArray = (bursts / np.abs(bursts).max()).astype(np.float32)
    return scaled


def _syllable(rng: np.random.Generator, pitch: float) -> FloatArray:
    """A fricative onset half of the time, then a vowel with a falling pitch."""
    samples = int(rng.uniform(0.12, 0.28) * SAMPLE_RATE)
    contour = pitch * rng.uniform(0.9, 1.15) * np.linspace(1.05, 0.9, samples)
    pulses = np.diff(np.floor(np.cumsum(contour) / SAMPLE_RATE), prepend=0.0)
    breath = 0.01 * rng.normal(size=samples)
    vowel = np.zeros(samples)
    source = scipy.signal.lfilter([1], [1, -0.9], pulses) + breath
    for formant in (*VOWELS[rng.integers(len(VOWELS))], 3500.0, 4500.0):
        vowel += _resonator(source, formant * rng.uniform(0.95, 1.05), 60 + 0.05 * formant)
    vowel *= np.hanning(samples) ** 0.4
    if rng.random() < 0.5:
        return vowel
    noise = rng.normal(size=int(rng.uniform(0.04, 0.1) * SAMPLE_RATE))
    hiss = _resonator(noise, rng.uniform(3000, 6000), 1500) * np.hanning(noise.size)
    return np.concatenate([0.4 * np.abs(vowel).max() * hiss / np.abs(hiss).max(), vowel])


def _resonator(signal: FloatArray, frequency: float, bandwidth: float) -> FloatArray:
    radius = np.exp(-np.pi * bandwidth / SAMPLE_RATE)
    pole = 2 * radius * np.cos(2 * np.pi * frequency / SAMPLE_RATE)
    filtered: FloatArray = scipy.signal.lfilter([1 - radius], [1, -pole, radius**2], signal)
    return filtered
