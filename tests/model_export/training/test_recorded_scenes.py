"""Unlabelled recordings as training scenes: reading, cutting, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile

from model_export.__main__ import main
from model_export.simulation.scenes import WINDOW_SAMPLES
from model_export.training.config import PAPER_SSCL
from model_export.training.recorded_scenes import RecordedScenes, loud_starts
from service.doa.presets import preset
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

ARRAY = preset("respeaker-usb-4mic-v2")


def noise(seconds: float, channels: int, rate: int = 16000) -> FloatArray:
    rng = np.random.default_rng(0)
    return 0.1 * rng.standard_normal((int(seconds * rate), channels))


def test_raw_channels_of_the_six_channel_firmware_are_taken(tmp_path: Path) -> None:
    audio = noise(2, 6)
    soundfile.write(tmp_path / "a.wav", audio, 16000, subtype="FLOAT")
    soundfile.write(tmp_path / "b.FLAC", audio[:, 1:5], 16000, format="FLAC")
    scenes, _ = RecordedScenes.split(tmp_path, ARRAY)
    six, four = scenes.audio
    np.testing.assert_allclose(six, (audio[:, 1:5] / np.abs(audio[:, 1:5]).max()).T, atol=1e-3)
    np.testing.assert_allclose(six, four, atol=2e-3)


def test_other_rates_are_resampled_without_moving_the_channels(tmp_path: Path) -> None:
    tone = np.sin(2 * np.pi * 400 * np.arange(96000) / 48000)
    audio = np.stack([np.roll(tone, delay) for delay in (0, 3, 6, 9)], axis=1)
    soundfile.write(tmp_path / "a.wav", 0.5 * audio, 48000)
    scenes, _ = RecordedScenes.split(tmp_path, ARRAY)
    assert scenes.audio[0].shape == (4, 32000)
    spectrum = np.fft.rfft(scenes.audio[0].astype(float)[:, 8000:24000])[:, 400]
    expected = -2 * np.pi * 400 * np.array([0, 3, 6, 9]) / 48000
    np.testing.assert_allclose(np.angle(spectrum / spectrum[0]), expected, atol=0.01)


def test_windows_come_from_all_that_is_loud_and_from_nothing_else(tmp_path: Path) -> None:
    audio = noise(20, 4)
    audio[: 8 * 16000] *= 1e-3
    soundfile.write(tmp_path / "a.wav", audio, 16000, subtype="FLOAT")
    scenes, _ = RecordedScenes.split(tmp_path, ARRAY)
    assert (scenes.starts[0] + WINDOW_SAMPLES > 8 * 16000).all()
    drawn = scenes.scenes(np.random.default_rng(0), PAPER_SSCL)
    windows = [next(drawn) for _ in range(60)]
    assert {window.audio.shape for window in windows} == {(4, WINDOW_SAMPLES)}
    assert all(window.audio.std() > 0.01 for window in windows)
    assert len({window.audio[0, 0] for window in windows}) > 40
    steady = np.ones((4, 10 * WINDOW_SAMPLES), dtype=np.float32)
    assert len(loud_starts(steady)) == 1 + 9 * WINDOW_SAMPLES // 1000


def test_of_ten_files_one_validates(tmp_path: Path) -> None:
    for index in range(10):
        soundfile.write(tmp_path / f"{index}.wav", noise(1.1 + 0.1 * index, 4), 16000)
    training, validation = RecordedScenes.split(tmp_path, ARRAY)
    lengths = [{samples.shape[1] for samples in part.audio} for part in (training, validation)]
    assert [len(part) for part in lengths] == [9, 1]
    assert not lengths[0] & lengths[1]


def refusal(folder: Path, capsys: pytest.CaptureFixture[str], config: str = "paper-sscl") -> str:
    """Message of the command, which ends with status 2."""
    run = str(folder / "run")
    command = ["train", "--config", config, "--run", run, "--recordings", str(folder), "--smoke"]
    assert main(command) == 2
    return capsys.readouterr().err


def test_an_empty_folder_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"no WAV or FLAC file below {tmp_path}" in refusal(tmp_path, capsys)


@pytest.mark.parametrize(
    ("audio", "message"),
    [
        (noise(2, 2), "the audio has 2 channels, but the array respeaker-usb-4mic-v2 has 4"),
        (noise(0.5, 4), "shorter than a window of 1.04 s"),
        (np.zeros((32000, 4)), "silent from beginning to end"),
        (np.full((32000, 4), np.nan), "channel 0 is nan at 0.000 s"),
    ],
)
def test_what_cannot_be_learned_from_is_named_with_the_reason(
    audio: FloatArray, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    soundfile.write(tmp_path / "bad.wav", audio, 16000, subtype="FLOAT")
    error = refusal(tmp_path, capsys)
    assert str(tmp_path / "bad.wav") in error
    assert message in error


def test_no_audio_at_all_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.flac").write_bytes(b"no audio")
    assert "bad.flac: the bytes are no audio file" in refusal(tmp_path, capsys)


def test_directions_are_not_learned_from_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    soundfile.write(tmp_path / "a.wav", noise(2, 4), 16000)
    assert "self-supervised" in refusal(tmp_path, capsys, "any-array")


def test_training_runs_on_recordings_alone(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "a.wav", noise(3, 6), 16000)
    run = tmp_path / "run"
    command = ["train", "--config", "paper-sscl", "--run", str(run), "--smoke"]
    assert main([*command, "--recordings", str(tmp_path)]) == 0
    assert len((run / "curves.csv").read_text().splitlines()) == 3
