"""Audio whose directions are known by construction, shared by all tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from service.machine.environment import prepare_process

prepare_process()  # as every process of the service does, before numpy is imported

import numpy as np
import pytest

from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.types import FloatArray

PlaneWaves = Callable[..., FloatArray]


@pytest.fixture(scope="session")
def square() -> MicrophoneArray:
    return preset("respeaker-usb-4mic-v2")


@pytest.fixture(scope="session")
def plane_waves() -> PlaneWaves:
    """Speech-like noises from given azimuths, delayed in the frequency domain."""

    def make(
        array: MicrophoneArray,
        azimuths_deg: Sequence[float],
        *,
        elevation_deg: float = 0.0,
        seconds: float = 1.04,
        snr_db: float = 25.0,
        rate: int = 16000,
        seed: int = 1,
    ) -> FloatArray:
        rng = np.random.default_rng(seed)
        samples = round(seconds * rate)
        omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / rate)
        audio = np.zeros((array.num_microphones, samples))
        for azimuth in np.deg2rad(azimuths_deg):
            source = np.fft.rfft(bursts(rng, samples, rate))
            height = np.deg2rad(elevation_deg)
            level = np.cos(height)
            direction = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)]
            advance = array.positions @ direction / 343.0
            audio += np.fft.irfft(source * np.exp(1j * omega * advance[:, None]), samples)
        power = np.mean(audio**2) if len(azimuths_deg) else 1.0
        audio += np.sqrt(power * 10 ** (-snr_db / 10)) * rng.standard_normal(audio.shape)
        return (0.1 * audio / np.abs(audio).max()).astype(np.float32)

    return make


def bursts(rng: np.random.Generator, samples: int, rate: int) -> FloatArray:
    """Syllables: pulse trains with a random pitch and noise, three to six a second."""
    signal = np.zeros(samples)
    start = 0
    while start < samples:
        length = int(rng.uniform(0.1, 0.25) * rate)
        pitch = rng.uniform(100, 220)
        phase = np.cumsum(np.full(length, pitch / rate))
        pulses = np.diff(np.floor(phase), prepend=0.0) + 0.03 * rng.standard_normal(length)
        piece = (pulses * np.hanning(length))[: samples - start]
        signal[start : start + piece.size] += piece
        start += length + int(rng.uniform(0.0, 0.06) * rate)
    return signal
