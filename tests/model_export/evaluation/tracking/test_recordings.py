"""Tracks of labelled recordings are counted by direction and by duration."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile

from model_export.evaluation.tracking.recordings import RealTracks, real_table, real_tracks
from service.doa.tracking import Detection
from service.doa.types import FloatArray


def estimates(audio: FloatArray, interval: float) -> Iterator[tuple[float, list[Detection]]]:
    """Detections of one talker at 90 degrees all the time and of one at 200 in the second half."""
    steps = round(audio.shape[1] / 16000 / interval)
    for step in range(1, steps + 1):
        found = [Detection(np.deg2rad(90), 0.95)]
        if step > steps // 2:
            found.append(Detection(np.deg2rad(200), 0.95))
        yield step * interval, found


def write(folder: Path, rate: int = 16000) -> None:
    soundfile.write(folder / "a.wav", np.zeros((6 * rate, 4), np.float32), rate)
    label = {"recordings": {"a.wav": {"azimuth_deg": [85, 300]}}}
    (folder / "labels.json").write_text(json.dumps(label))


def test_tracks_near_a_talker_are_counted(tmp_path: Path) -> None:
    write(tmp_path)
    found = real_tracks(tmp_path, estimates, 0.1)["a.wav"]
    assert (found.talkers, found.ids) == (2, 2)
    # A track may take an update or two to be sure; nobody is at 200 degrees.
    assert 57 <= found.near <= 60
    assert found.reported - found.near == 30


def test_the_table_has_a_row_for_every_recording() -> None:
    table = real_table({"a.wav": RealTracks(talkers=2, reported=90, near=60, ids=2)})
    assert "| a.wav | 2 | 2 | 60 of 90 |" in table


def test_another_sample_rate_is_refused(tmp_path: Path) -> None:
    write(tmp_path, 48000)
    with pytest.raises(ValueError, match="resample"):
        real_tracks(tmp_path, estimates, 0.1)
