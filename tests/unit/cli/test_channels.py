"""One file with more channels than microphones, asked of everything that takes recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
from command_line import refusal, run
from stream_command import ARRAY, RATE

from neuralmusic.cli.stream_outputs import note
from neuralmusic.protocol.server_messages import StreamWarning
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.noise_profile import load_noise

AZIMUTH = 60.0
CODE = "channel_map_assumed"
LAYOUT = [1, 2, 3, 4]
"""Seeed's usb_4_mic_array README: 0 is processed, 1 to 4 are the microphones, 5 is playback"""
WriteChannels = Callable[[int], str]


@pytest.fixture
def wave(square: MicrophoneArray, plane_waves: Any) -> FloatArray:
    sound: FloatArray = plane_waves(square, [AZIMUTH], seconds=3.0)
    return sound


@pytest.fixture
def write_channels(tmp_path: Path, wave: FloatArray) -> WriteChannels:
    """Write the wave into channels 1 to 4 of so many."""

    def write(channels: int) -> str:
        audio = 0.01 * np.random.default_rng(3).standard_normal((channels, wave.shape[1]))
        audio[LAYOUT] = wave
        path = tmp_path / f"{channels}.wav"
        soundfile.write(path, audio.T, RATE, subtype="FLOAT")
        return str(path)

    return write


def post(url: str, path: str) -> httpx2.Response:
    fields = {"array": ARRAY, "method": "norm_music", "num_sources": "1"}
    files = {"audio": Path(path).read_bytes()}
    return httpx2.post(f"{url}/localize", data=fields, files=files, timeout=60)


def test_everything_takes_the_layout_of_a_known_firmware_and_says_so(
    write_channels: WriteChannels,
    wave: FloatArray,
    real_service: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = write_channels(6)
    flags = [path, "--array", ARRAY]
    method = ["--method", "norm_music", "--num-sources", "1"]

    answers = [post(real_service, path).json()]
    answers.append(json.loads(run(capsys, "localize", *flags, *method, "--json")[1]))
    checked = json.loads(run(capsys, "check", *flags, "--json")[1])
    (warning,) = checked["warnings"]
    assert warning["code"] == CODE
    assert "channel_map=1,2,3,4" in warning["detail"]
    for answer in answers:
        assert answer["array"]["channel_map"] == checked["channel_map"] == LAYOUT
        assert warning in answer["warnings"]
        (source,) = answer["summary"]["sources"]
        assert source["azimuth_deg"] == pytest.approx(AZIMUTH, abs=3)
    said = note(StreamWarning(seq=0, **warning))

    stream = ["stream", *flags, *method, "--url", real_service]
    _, out, err = run(capsys, *stream, "--output", "jsonl")
    assert said in err.splitlines()
    (source,) = json.loads(out.splitlines()[-1])["sources"]
    assert source["azimuth_deg"] == pytest.approx(AZIMUTH, abs=3)
    assert "(channels 1, 2, 3, 4)" in run(capsys, *stream, "--output", "table")[1]

    soundfile.write(tmp_path / "microphones.wav", wave.T, RATE, subtype="FLOAT")
    profile, truth = tmp_path / "profile.npz", tmp_path / "truth.npz"
    assert said in run(capsys, "noise", *flags, "--output", str(profile))[1].splitlines()
    run(capsys, "noise", str(tmp_path / "microphones.wav"), *flags[1:], "--output", str(truth))
    learnt, expected = (load_noise(each).covariance for each in (profile, truth))
    np.testing.assert_array_equal(learnt, expected)


def test_everything_refuses_channels_that_fit_nothing(
    write_channels: WriteChannels,
    real_service: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = write_channels(7)
    problem = post(real_service, path).json()
    assert problem["code"] == "channel_mismatch"
    assert "the audio has 7 channels" in problem["detail"]
    more = {"stream": ["--url", real_service], "noise": ["--output", str(tmp_path / "x.npz")]}
    for command in ("check", "localize", "stream", "noise"):
        said = refusal(capsys, command, path, "--array", ARRAY, *more.get(command, []))
        assert said == f"error: {problem['detail']}\n"


def test_a_map_that_is_given_wins(
    write_channels: WriteChannels, real_service: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = [write_channels(6), "--array", ARRAY, "--channel-map", "4,3,2,1"]
    checked = json.loads(run(capsys, "check", *flags, "--json")[1])
    assert (checked["channel_map"], checked["warnings"]) == ([4, 3, 2, 1], [])
    _, out, _ = run(capsys, "stream", *flags, "--url", real_service, "--output", "table")
    assert "(channels 4, 3, 2, 1)" in out
    assert CODE not in out
