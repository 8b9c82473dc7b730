"""Noises of real arrays: sensor, diffuse and coupled noise.

Diffuse noise is coloured by a random slope or, where recordings are given, by a recording's
spectrum over time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft
import scipy.signal

from service.doa.types import FloatArray

FRAME = 512
"""Samples in a frame of the STFT that shapes diffuse noise like a recording"""


def unit_power(audio: FloatArray) -> FloatArray:
    """Scale (N, T) audio to unit variance at its first microphone."""
    power = float(np.mean(audio[0].astype(np.float64) ** 2))
    return audio / np.float32(np.sqrt(max(power, 1e-12)))


def sensor_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """White noise (N, T) float32 of unit variance, independent at every microphone."""
    return rng.standard_normal(shape, dtype=np.float32)


def coupled_noise(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """Coloured noise (N, T) float32 that is the same in some or all channels.

    One converter serves two or four channels; noise that couples into it is in phase in them all.
    """
    common = unit_power(colour(rng, rng.standard_normal((1, shape[1]), dtype=np.float32)))
    members = rng.random(shape[0]) < rng.choice([0.5, 1.0])
    return members[:, None] * common


def colour(rng: np.random.Generator, noise: FloatArray) -> FloatArray:
    """Give noise (N, T) a random spectral slope and a random resonance."""
    spectrum = scipy.fft.rfft(noise, axis=-1)
    frequency = np.linspace(1e-3, 1, spectrum.shape[-1], dtype=np.float32)
    slope = frequency ** np.float32(-rng.uniform(0, 1.2))
    centre, width = rng.uniform(0.02, 0.8), rng.uniform(0.02, 0.3)
    resonance = 1 + rng.uniform(0, 4) * np.exp(-0.5 * ((frequency - centre) / width) ** 2)
    coloured: FloatArray = scipy.fft.irfft(
        spectrum * np.minimum(slope, 100) * resonance.astype(np.float32), noise.shape[-1], axis=-1
    )
    return coloured


def shaped_like(noise: FloatArray, recording: FloatArray) -> FloatArray:
    """Give white noise (N, T) a mono recording's spectrum over time; its phases stay diffuse."""
    options = {"nperseg": FRAME, "noverlap": FRAME // 2}
    _, _, spectra = scipy.signal.stft(noise, **options)
    _, _, recorded = scipy.signal.stft(recording[: noise.shape[-1]], **options)
    frames = min(spectra.shape[-1], recorded.shape[-1])
    shaped = spectra[..., :frames] * np.abs(recorded[:, :frames])
    _, audio = scipy.signal.istft(shaped, **options)
    result = np.zeros_like(noise)
    length = min(audio.shape[-1], noise.shape[-1])
    result[:, :length] = audio[:, :length]
    return result


def excerpt(
    rng: np.random.Generator, recordings: Sequence[FloatArray], num_samples: int
) -> FloatArray:
    """Excerpt (T,) of a random recording from a random sample on, repeated if it is too short."""
    recording = recordings[int(rng.integers(len(recordings)))]
    offset = int(rng.integers(len(recording)))
    return np.resize(np.roll(recording, -offset), num_samples)
