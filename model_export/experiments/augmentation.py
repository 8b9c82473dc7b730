"""What training adds to a batch of scenes: noise, symmetries of the array."""

from __future__ import annotations

import numpy as np

from model_export.simulation.noise import sensor_noise
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray, IntArray

NOISE_PROBABILITY = 0.6
NOISE_SNR_DB = (-10.0, 30.0)
"""Both as in the paper's code"""
SYMMETRIC = 1e-4
"""Metres by which a microphone of a turned array may miss another's place"""


def white_noise(rng: np.random.Generator, audio: FloatArray, snr_db: float) -> FloatArray:
    """Audio (N, T) with white noise at this ratio to its mean power over microphones and time."""
    sigma = np.sqrt(np.mean(np.square(audio)) * 10 ** (-snr_db / 10))
    noisy: FloatArray = audio + np.float32(sigma) * sensor_noise(rng, audio.shape)
    return noisy


def sometimes_noisy(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    """Windows (B, N, T), some with white noise of their own at a random ratio."""
    return np.stack(
        [
            white_noise(rng, window, rng.uniform(*NOISE_SNR_DB))
            if rng.random() < NOISE_PROBABILITY
            else window
            for window in audio
        ]
    )


def symmetries(array: MicrophoneArray) -> list[tuple[IntArray, float]]:
    """Turns about z that bring every microphone to another's place, the identity among them.

    Audio whose channels are taken in the order ``permutation`` is what the array hears when the
    sources are turned counter-clockwise by ``azimuth`` radians: exact data for nothing. A ring of
    N microphones has N, an irregular array only the identity.
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
