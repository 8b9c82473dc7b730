"""Silent windows: an answer without sources, at next to no cost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from service import localize
from service.doa.array import MicrophoneArray
from service.recordings import localize as recordings

RATE = 16_000


@pytest.mark.parametrize("method", ["neural", "music", "norm_music", "srp_phat"])
def test_silence_is_not_computed(
    method: str, square: MicrophoneArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed(*_: Any) -> None:
        raise AssertionError("a window of silence was computed")

    monkeypatch.setattr(recordings, "estimate_stretch", computed)
    samples = np.zeros((5 * RATE, 4), np.int16)
    answer = localize(samples, RATE, array=square.name, method=method, spectrum=True)
    assert len(answer.windows) == 9
    for window in answer.windows:
        assert window.sources == []
        assert window.spectrum == [0.0] * 360


def test_a_sound_amid_silence_is_found_where_it_is(
    square: MicrophoneArray, plane_waves: Any
) -> None:
    samples = np.zeros((60 * RATE, 4), np.float32)
    samples[30 * RATE : 32 * RATE] = plane_waves(square, [60], seconds=2.0).T
    answer = localize(samples, RATE, array=square.name)
    heard = [window for window in answer.windows if window.sources]
    assert heard
    for window in heard:
        assert 29 < window.t_start < 32
        assert window.sources[0].azimuth_deg == pytest.approx(60, abs=3)
