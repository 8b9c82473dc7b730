"""Plane waves on an array by exact delays, made without the package's steering vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

SAMPLE_RATE = 16000
SPEED_OF_SOUND = 343.0


def plane_waves(
    array: MicrophoneArray,
    azimuth_deg: Sequence[float],
    *,
    num_samples: int = 8192,
    snr_db: float = 40.0,
    seed: int = 1,
) -> FloatArray:
    """(N, T) float32: independent white sources, each in bursts of its own, and sensor noise.

    A microphone p hears a source from the unit vector u by p . u / c seconds earlier than the
    origin does; the delay is exact in the frequency domain, over the circle of the window.
    """
    rng = np.random.default_rng(seed)
    frequencies = np.fft.rfftfreq(num_samples, 1 / SAMPLE_RATE)
    audio = np.zeros((array.num_microphones, num_samples))
    for azimuth in np.deg2rad(azimuth_deg):
        loudness = np.repeat(rng.uniform(0.1, 1.0, num_samples // 512), 512)
        spectrum = np.fft.rfft(loudness * rng.standard_normal(num_samples))
        lead = array.positions[:, :2] @ [np.cos(azimuth), np.sin(azimuth)] / SPEED_OF_SOUND
        phase = np.exp(2j * np.pi * frequencies * lead[:, None])
        audio += np.fft.irfft(spectrum * phase, n=num_samples)
    noise = 10 ** (-snr_db / 20) * audio.std()
    return (audio + noise * rng.standard_normal(audio.shape)).astype(np.float32)
