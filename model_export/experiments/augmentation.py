"""Augmentation of a batch of scenes: noise, and symmetries of the array."""

from __future__ import annotations

import numpy as np

from model_export.simulation.noise import sensor_noise
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray, IntArray

NOISE_PROBABILITY = 0.6
NOISE_SNR_DB = (-10.0, 30.0)
"""Range of the SNR of added noise; it and the probability are those of the paper's code"""
SYMMETRIC = 1e-4
"""Metres by which a turned microphone may miss another's position"""


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


def symmetries(array: MicrophoneArray) -> list[tuple[IntArray, float]]:
    """Turns about z that map every microphone to another's position, including the identity.

    Each is a pair of a permutation (N,) and a turn in radians. Audio with its channels in this
    order is exactly what the array hears from sources turned counter-clockwise by that angle. A
    ring of N microphones has N symmetries, an irregular array only the identity.
    """
    plane = array.positions - array.positions.mean(axis=0)
    found: list[tuple[IntArray, float]] = []
    angles = np.arctan2(plane[:, 1], plane[:, 0])
    for turn in np.unique(np.round((angles - angles[0]) % (2 * np.pi), 6)).tolist():
        turned = MicrophoneArray(array.name, plane).rotated(turn).positions
        gaps = np.linalg.norm(plane[:, None] - turned[None], axis=-1)
        permutation = gaps.argmin(axis=1)
        if gaps.min(axis=1).max() < SYMMETRIC and len(set(permutation.tolist())) == len(plane):
            found.append((permutation, turn))
    return found
