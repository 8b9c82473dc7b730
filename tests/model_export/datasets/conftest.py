"""Sound fields from known places, and NormMUSIC on the item's array to find them again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.classical import ClassicalLocalizer

SPEED_OF_SOUND = 343.0


@pytest.fixture(scope="session")
def spherical_waves() -> Callable[..., FloatArray]:
    """Noise (N, T) from one point, delayed and attenuated on its way to every microphone."""

    def make(
        microphones: FloatArray, source: FloatArray, seconds: float = 1.2, rate: int = 16000
    ) -> FloatArray:
        samples = round(seconds * rate)
        rng = np.random.default_rng(3)
        spectrum = np.fft.rfft(rng.standard_normal(samples))
        frequency = np.fft.rfftfreq(samples, 1 / rate)
        spectrum[frequency > 7000] = 0
        distance = np.linalg.norm(np.asarray(microphones) - source, axis=1)
        delays = np.exp(-2j * np.pi * frequency * distance[:, None] / SPEED_OF_SOUND)
        audio = np.fft.irfft(spectrum * delays / distance[:, None], samples)
        audio += 0.01 * audio.std() * rng.standard_normal(audio.shape)
        return (0.3 * audio / np.abs(audio).max()).astype(np.float32)

    return make


@pytest.fixture(scope="session")
def localize() -> Callable[[FloatArray, MicrophoneArray], float]:
    """The azimuth in radians of the one source in audio (N, T)."""

    def answer(audio: FloatArray, array: MicrophoneArray) -> float:
        (estimate,) = ClassicalLocalizer("norm_music", array).estimate(audio[None], 1, 1)
        return float(estimate.sources[0].azimuth)

    return answer


@pytest.fixture(scope="session")
def write_wav() -> Callable[..., None]:
    """Write audio (N, T) or (T,) as 16 bits."""

    def write(path: Path, audio: FloatArray, rate: int = 16000) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        soundfile.write(path, audio.T, rate, subtype="PCM_16")

    return write
