"""Augmentation of a batch of scenes: noise."""

from __future__ import annotations

import numpy as np

from model_export.simulation.noise import sensor_noise
from service.doa.types import FloatArray

NOISE_PROBABILITY = 0.6
NOISE_SNR_DB = (-10.0, 30.0)
"""Range of the SNR of added noise; it and the probability are those of the paper's code"""


def white_noise(rng: np.random.Generator, audio: FloatArray, snr_db: float) -> FloatArray:
    """Audio (N, T) with white noise; the SNR refers to the mean power over microphones and time."""
    sigma = np.sqrt(np.mean(np.square(audio)) * 10 ** (-snr_db / 10))
    noisy: FloatArray = audio + np.float32(sigma) * sensor_noise(rng, audio.shape)
    return noisy


def sometimes_noisy(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Windows (B, N, T), some with independent white noise at a random SNR."""
    return np.stack(
        [
            white_noise(rng, window, rng.uniform(*NOISE_SNR_DB))
            if rng.random() < NOISE_PROBABILITY
            else window
            for window in audio
        ]
    )
