"""Recordings that are too short to count sources in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from command_line import run

from service import localize
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

RATE = 16_000


def near_silence(seconds: float) -> FloatArray:
    """(T, 4) sensor noise at -80 dBFS."""
    rng = np.random.default_rng(1)
    return (1e-4 * rng.standard_normal((round(seconds * RATE), 4))).astype(np.float32)


@pytest.mark.parametrize("method", ["neural", "norm_music"])
@pytest.mark.parametrize(("seconds", "short"), [(0.03, True), (0.1, True), (0.15, False)])
def test_a_blink_of_noise_is_nobody(
    seconds: float, short: bool, method: str, square: MicrophoneArray
) -> None:
    answer = localize(near_silence(seconds), RATE, array=square.name, method=method)
    assert [window.sources for window in answer.windows] == [[]]
    assert ("too_short" in [warning.code for warning in answer.warnings]) is short


def test_directions_that_are_asked_for_are_given(square: MicrophoneArray, plane_waves) -> None:
    sound = plane_waves(square, [60])[:, 4000:5600].T
    answer = localize(sound, RATE, array=square.name, num_sources=1)
    assert answer.windows[0].sources[0].azimuth_deg == pytest.approx(60, abs=4)
    assert "too_short" in [warning.code for warning in answer.warnings]


def test_the_rest_after_the_last_whole_window_is_nobody(square: MicrophoneArray) -> None:
    answer = localize(near_silence(1.1), RATE, array=square.name, window_s=1.0, hop_s=1.0)
    assert [window.sources for window in answer.windows] == [[], []]
    assert "too_short" not in [warning.code for warning in answer.warnings]


def test_check_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.wav"
    soundfile.write(path, 100 * near_silence(0.1), RATE)
    code, out, _ = run(capsys, "check", str(path), "--json")
    assert code == 1
    assert [each["code"] for each in json.loads(out)["warnings"]] == ["too_short"]
    code, out, err = run(capsys, "check", str(path))
    assert code == 1
    assert "too_short" in out + err
    assert "nothing wrong" not in out
