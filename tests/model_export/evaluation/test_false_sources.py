"""Recordings without talkers are what their names say, and reports of them are counted."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
import soundfile

from model_export.evaluation.false_sources import (
    NOISES,
    Noise,
    false_source_scores,
    noise_file,
    own_fan,
    recorded,
    score_noise,
)
from model_export.evaluation.methods import Methods
from model_export.evaluation.workers import Inputs
from model_export.simulation.fan import BLADES, CORNER, ROTATION, air_noise, fan_tones
from service.doa.presets import preset
from service.inference.registry import EMBEDDED_MODELS
from service.inference.results import Source, WindowEstimate
from service.recordings.results import RecordingResult, SummarySource, WindowResult

RATE = 16000
SQUARE = preset("respeaker-usb-4mic-v2")


def test_the_fan_s_tones_are_its_blades() -> None:
    frequency, power = scipy.signal.welch(
        fan_tones(np.random.default_rng(1), 20 * RATE), RATE, nperseg=8192
    )
    for harmonic in range(1, 9):
        passing = harmonic * ROTATION * BLADES
        near = power[np.abs(frequency - passing) < 0.02 * passing].max()
        between = power[np.abs(frequency - passing - 150) < 30].max()
        assert near > 1000 * between
    assert np.sum(power[np.abs(frequency - 300) < 10]) > np.sum(power[frequency > 400])


def test_the_air_falls_by_6_db_an_octave_and_is_another_one_at_every_microphone() -> None:
    noise = air_noise(np.random.default_rng(2), 2, 20 * RATE)
    frequency, power = scipy.signal.welch(noise[0], RATE, nperseg=2048)
    octaves = [power[np.abs(frequency - f) < 0.1 * f].mean() for f in (2400, 4800)]
    assert 10 * np.log10(octaves[0] / octaves[1]) == pytest.approx(6, abs=0.7)
    low = power[(frequency > 100) & (frequency < 0.3 * CORNER)].mean()
    assert 10 * np.log10(low / power[np.abs(frequency - CORNER) < 50].mean()) < 4
    assert np.corrcoef(noise)[0, 1] == pytest.approx(0, abs=0.02)


def test_the_robot_s_own_fan_is_coherent_in_its_tones_alone() -> None:
    audio = own_fan(-90.0, np.random.default_rng(3), SQUARE.positions, 20 * RATE)
    frequency, coherence = scipy.signal.coherence(audio[0], audio[1], RATE, nperseg=4096)
    assert coherence[np.abs(frequency - 300) < 4].max() > 0.9
    assert np.median(coherence[(frequency > 320) & (frequency < 580)]) < 0.1


def test_silence_and_white_noise_give_no_false_source() -> None:
    inputs = Inputs(Methods([EMBEDDED_MODELS / "any-array"]), [], seed=8)
    for noise in NOISES[:2]:
        scores = score_noise(inputs, replace(noise, seconds=3.0))
        assert scores["any-array"]["false_sources_per_minute"] == 0


@pytest.mark.parametrize("noise", NOISES[1:], ids=lambda noise: noise.name)
def test_every_noise_has_its_level_and_the_array_s_channels(noise: Noise) -> None:
    samples, rate = soundfile.read(noise_file(replace(noise, seconds=4.5), SQUARE, seed=1))
    assert (samples.shape, rate) == ((72000, 4), RATE)
    assert 20 * np.log10(samples[:, 0].std()) == pytest.approx(-35, abs=0.1)
    assert samples[-RATE:, 0].std() == pytest.approx(samples[:, 0].std(), rel=0.2)


def test_a_recording_is_spread_over_all_directions(tmp_path: Path) -> None:
    """Its spectrum stays, and microphones lose coherence as in a diffuse field."""
    tone = np.sin(2 * np.pi * 3000 * np.arange(RATE) / RATE)
    rain = 0.2 * np.random.default_rng(4).standard_normal(RATE)
    soundfile.write(tmp_path / "rain.flac", 0.1 * (tone + rain), RATE)
    (noise,) = recorded([tmp_path / "rain.flac"])
    samples, _ = soundfile.read(noise_file(replace(noise, seconds=20.0), SQUARE, seed=1))
    frequency, power = scipy.signal.welch(samples[:, 0], RATE, nperseg=1024)
    assert frequency[power.argmax()] == 3000
    _, coherence = scipy.signal.coherence(samples[:, 0], samples[:, 2], RATE, nperseg=1024)
    assert np.median(coherence[frequency > 4000]) < 0.3
    assert np.median(coherence[frequency < 400]) > 0.7
    assert noise.name == "60 s of rain, diffuse"
    assert isinstance(noise.sound, partial)


def test_reports_are_counted_per_minute() -> None:
    source = Source(1.0, 0.9)
    windows = [
        WindowResult(0.5 * index, 0.5 * index + 1, WindowEstimate(found, np.zeros(360)))
        for index, found in enumerate([(), (source,), (source, source), ()])
    ]
    result = RecordingResult(
        method="neural",
        model=None,
        sample_rate=RATE,
        channels=4,
        duration=30.0,
        array=SQUARE,
        channel_map=(0, 1, 2, 3),
        windows=windows,
        summary=[SummarySource(1.0, 0.9, 1.0)],
    )
    assert false_source_scores(result) == {
        "false_sources_per_minute": 6.0,
        "summary_sources_per_minute": 2.0,
        "reporting_windows_per_minute": 4.0,
    }
