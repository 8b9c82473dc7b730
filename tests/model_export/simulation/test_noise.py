"""Noises and imperfections of training scenes against physics and converters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.signal
import soundfile

from model_export.datasets.noise import noise_recordings
from model_export.simulation.fan import random_fan
from model_export.simulation.imperfections import band_limit, crosstalk, mismatch, quantised
from model_export.simulation.noise import coupled_noise, excerpt, shaped_like, unit_power
from model_export.simulation.rooms import RoomSpec, impulse_responses, paper_room
from model_export.simulation.scenes import Scene, direct_response
from model_export.simulation.synthesis import sound_bursts
from service.doa.steering import unit_vectors

pytestmark = pytest.mark.torch
SAMPLES = 16640


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def share(audio: np.ndarray, low: float, high: float) -> float:
    """Share of the power between two frequencies in hertz."""
    frequency, density = scipy.signal.welch(audio, 16000, nperseg=4096)
    return float(density[(frequency >= low) & (frequency < high)].sum() / density.sum())


def test_a_fan_is_steady_and_never_silent(rng: np.random.Generator) -> None:
    for _ in range(5):
        audio = random_fan(rng, 32000)
        levels = np.square(audio[: 20 * 1600].reshape(20, -1)).mean(axis=1)
        assert levels.max() < 3 * levels.min()


def test_bursts_come_and_go_and_are_never_silent_for_a_window(rng: np.random.Generator) -> None:
    for _ in range(5):
        audio = sound_bursts(rng, 2.0)
        assert np.isfinite(audio).all()
        levels = np.square(audio[: 40 * 800].reshape(40, -1)).mean(axis=1)
        assert levels.max() > 10 * levels.min()
        assert levels.reshape(2, 20).max(axis=1).min() > 0.01 * levels.max()


def test_noise_shaped_like_a_recording_has_its_spectrum_and_its_pauses(
    rng: np.random.Generator,
) -> None:
    low = scipy.signal.butter(4, 1000, fs=16000, output="sos")
    recording = scipy.signal.sosfilt(low, rng.standard_normal(SAMPLES)).astype(np.float32)
    recording[:8000] = 0
    noise = rng.standard_normal((3, SAMPLES)).astype(np.float32)
    shaped = shaped_like(noise, recording)
    assert share(shaped[0, 9000:], 0, 1500) > 0.95
    assert np.square(shaped[:, :7000]).mean() < 1e-3 * np.square(shaped[:, 9000:]).mean()
    # Independent microphones stay independent.
    assert abs(np.corrcoef(shaped[:2, 9000:])[0, 1]) < 0.2


def test_coupled_noise_is_the_same_in_every_channel_that_it_reaches(
    rng: np.random.Generator,
) -> None:
    noise = coupled_noise(rng, (8, 4000))
    reached = noise[np.abs(noise).max(axis=1) > 0]
    assert len(reached) >= 1
    np.testing.assert_array_equal(reached, np.broadcast_to(reached[0], reached.shape))


def test_an_excerpt_has_the_wanted_length_from_any_recording(rng: np.random.Generator) -> None:
    assert excerpt(rng, [np.arange(100.0)], 250).shape == (250,)
    assert excerpt(rng, [np.arange(1000.0)], 250).shape == (250,)


def test_mismatched_microphones_differ_by_a_gain_and_microseconds(
    rng: np.random.Generator,
) -> None:
    time = np.arange(SAMPLES) / 16000
    tone = np.sin(2 * np.pi * 1000 * time) * np.hanning(SAMPLES)
    audio = mismatch(rng, np.tile(tone, (6, 1)).astype(np.float32))
    spectra = np.fft.rfft(audio)[:, 1040]
    gains = 20 * np.log10(np.abs(spectra) / np.abs(np.fft.rfft(tone)[1040]))
    delays = np.angle(spectra / np.fft.rfft(tone)[1040]) / (2 * np.pi * 1000)
    assert 0.1 < np.std(gains) < 4
    assert np.abs(delays).max() < 25e-6


def test_crosstalk_leaks_a_little_of_the_neighbour(rng: np.random.Generator) -> None:
    audio = np.zeros((4, 100), np.float32)
    audio[1] = 1
    leaked = crosstalk(rng, audio)
    np.testing.assert_array_equal(leaked[1], audio[1])
    assert 10 ** (-45 / 20) <= leaked[2, 0] <= 10 ** (-22 / 20)
    assert not leaked[[0, 3]].any()


def test_a_band_limit_leaves_nothing_above_its_edge(rng: np.random.Generator) -> None:
    limited = band_limit(rng, rng.standard_normal((2, SAMPLES)).astype(np.float32))
    assert share(limited[0], 7700, 8000) < 1e-4
    assert share(limited[0], 0, 3100) > 0.35


def test_quantised_audio_has_few_levels_and_keeps_its_scale(rng: np.random.Generator) -> None:
    audio = unit_power(rng.standard_normal((2, SAMPLES)).astype(np.float32))
    coarse = min((quantised(rng, audio) for _ in range(20)), key=lambda a: np.unique(a).size)
    assert np.unique(coarse).size < 3000
    assert np.corrcoef(coarse[0], audio[0])[0, 1] > 0.9
    assert np.square(coarse).mean() == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0])
def test_the_direct_response_is_that_of_a_room_without_walls(distance: float) -> None:
    position, source = np.zeros((1, 3)), distance * unit_vectors(np.array([0.7]))
    room = impulse_responses(paper_room(4), position, source)[0, 0]
    free = RoomSpec(paper_room(0).size, paper_room(0).centre, rt60=0.0)
    (expected,) = impulse_responses(free, position, source)[0]
    direct = direct_response(room, distance)
    expected = np.pad(expected, (0, max(0, room.size - expected.size)))[: room.size]
    assert np.square(direct - expected).sum() < 0.03 * np.square(expected).sum()


def test_recordings_are_noise_or_events_by_their_name(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    steady = rng.uniform(-0.5, 0.5, 16000)
    bark = np.concatenate([np.zeros(30000), rng.uniform(-0.5, 0.5, 8000), np.zeros(30000)])
    for name, audio in {"Rain_00": steady, "my_fan": steady, "Dog_bark_03": bark}.items():
        soundfile.write(tmp_path / f"{name}.flac", audio, 16000)
    soundfile.write(tmp_path / "Clock_tick_00.flac", steady, 16000)
    assert len(noise_recordings(tmp_path, "steady")) == 2
    (event,) = noise_recordings(tmp_path, "events")
    assert 8000 <= event.size <= 10000  # the silence around it is gone
    assert np.abs(event).max() == pytest.approx(1)


def test_a_folder_without_noise_is_explained(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no recordings of steady"):
        noise_recordings(tmp_path, "steady")
    soundfile.write(tmp_path / "rain.wav", np.zeros((16000, 2)), 16000)
    with pytest.raises(ValueError, match="expected mono audio at 16000 Hz"):
        noise_recordings(tmp_path, "steady")


def test_a_part_of_a_scene_keeps_the_talkers_that_sound_in_it(rng: np.random.Generator) -> None:
    direct = rng.standard_normal((2, SAMPLES)).astype(np.float32)
    direct[0, 8000:] = 0
    direct[1, :8000] = 0
    scene = Scene(direct.copy(), np.zeros((2, 3)), np.array([1.0, 2.0]), direct, direct.sum(axis=0))
    assert scene.crop(0, 7000).azimuth.tolist() == [1.0]
    assert scene.crop(9000, 7000).azimuth.tolist() == [2.0]
    part = scene.crop(6000, 4000)
    assert part.azimuth.tolist() == [1.0, 2.0]
    assert part.audio.shape == (2, 4000)
    np.testing.assert_array_equal(part.heard, scene.heard[6000:10000])
