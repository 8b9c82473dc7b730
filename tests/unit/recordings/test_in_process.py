"""``service.localize``: the answer of the HTTP interface without a server."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from command_line import run

from neuralmusic.errors import AudioError, ChannelMismatch, InvalidOption, UnsupportedSampleRate
from service import localize
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

RATE = 16_000


@pytest.fixture
def samples(square: MicrophoneArray, plane_waves: Any) -> FloatArray:
    """(T, N) of a talker at 60 degrees."""
    wave: FloatArray = plane_waves(square, [60], seconds=1.5).T
    return wave


@pytest.fixture
def path(samples: FloatArray, tmp_path: Path) -> Path:
    path = tmp_path / "talk.wav"
    soundfile.write(path, samples, RATE, subtype="FLOAT")
    return path


def test_a_path_a_file_and_an_array_get_the_answer_of_the_service(
    samples: FloatArray, path: Path, square: MicrophoneArray, capsys: pytest.CaptureFixture[str]
) -> None:
    found = localize(path, array=square.name, method="norm_music")
    assert localize(samples, RATE, array=square.name, method="norm_music") == found
    assert localize(io.BytesIO(path.read_bytes()), array=square.name, method="norm_music") == found
    _, out, _ = run(
        capsys, "localize", str(path), "--array", square.name, "--method", "norm_music", "--json"
    )
    assert json.loads(found.model_dump_json(exclude_unset=True)) == json.loads(out)
    assert found.summary.sources[0].azimuth_deg == pytest.approx(60, abs=3)


def test_options_are_python_s_own(samples: FloatArray, square: MicrophoneArray) -> None:
    integers = (samples * 32_767).astype(np.int16)
    found = localize(
        integers,
        RATE,
        array=square.positions,
        method="music",
        channel_map=[0, 1, 2, 3],
        num_sources=1,
        yaw_deg=90,
        exclude_deg=[(0, 20)],
        spectrum=True,
    )
    assert found.summary.sources[0].azimuth_deg == pytest.approx(150, abs=3)
    assert len(found.windows[0].spectrum or ()) == 360


def test_what_is_wrong_is_said(samples: FloatArray, square: MicrophoneArray) -> None:
    with pytest.raises(AudioError, match="sample_rate"):
        localize(samples, array=square.name)
    with pytest.raises(InvalidOption, match="hop_s must be from"):
        localize(samples, RATE, array=square.name, hop_s=100)
    with pytest.raises(ChannelMismatch, match="transpose"):
        localize(samples.T, RATE, array=square.name)
    for rate in (0, 16_000.5, "16000"):
        with pytest.raises(UnsupportedSampleRate, match="whole number"):
            localize(samples, rate, array=square.name)  # type: ignore[arg-type]


def test_a_file_s_own_sample_rate_is_not_overruled(path: Path, square: MicrophoneArray) -> None:
    with pytest.raises(InvalidOption, match="its own sample_rate"):
        localize(path, 8_000, array=square.name)
