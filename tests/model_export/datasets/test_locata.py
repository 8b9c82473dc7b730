"""LOCATA: arrays that stand turned or move, in files as published, at 48 kHz."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.fault import DatasetError
from model_export.datasets.locata import LOCATA
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

CLOCK = ["year", "month", "day", "hour", "minute", "second"]
POSE = [
    *CLOCK,
    *("x", "y", "z"),
    *("ref_vec_x", "ref_vec_y", "ref_vec_z"),
    *(f"rotation_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
]
RATE = 48_000
SECONDS = 1.2
HEAD = np.array([1.5, -0.7, 1.2])
"""The array's reference point in the room, metres"""
AHEAD = HEAD + np.array([0.0, 2.0, 0.0])
"""A source in front of the array where it is not turned"""
RING = [
    [0.06 * np.cos(a), 0.06 * np.sin(a), z]
    for a, z in zip(np.arange(12) * np.pi / 6, [0.0, 0.0, 0.03] * 4, strict=True)
]
"""Twelve microphones in the array's own frame"""

AddRecording = Callable[..., Path]


def about_z(degrees: float) -> FloatArray:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def clock(seconds: float) -> list[float]:
    """Calendar time at seconds after the audio's first sample, a moment before midnight."""
    time = datetime(2017, 6, 30, 23, 59, 59, 400_000) + timedelta(seconds=seconds)
    second = time.second + time.microsecond / 1e6
    return [time.year, time.month, time.day, time.hour, time.minute, second]


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
    lines = ["\t".join(header), *("\t".join(f"{value:.9g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def add_recording(
    tmp_path: Path,
    write_wav: Callable[..., None],
    spherical_waves: Callable[..., FloatArray],
) -> AddRecording:
    """One recording of a source at a place, by an array with a given rotation at each time."""

    def add(
        source: Sequence[float],
        turns: Sequence[float] = (0.0,) * 160,
        *,
        place: str = "dev/task1/recording1",
        microphones: Sequence[Sequence[float]] = RING,
        array: str = "benchmark2",
        names: Sequence[str] = ("loudspeaker1",),
    ) -> Path:
        folder = tmp_path / place / array
        folder.mkdir(parents=True)
        times = -0.004 + np.arange(len(turns)) / 120
        rotations = [about_z(turn) for turn in turns]
        fields = [HEAD + np.asarray(microphones) @ rotation.T for rotation in rotations]
        audio = spherical_waves(fields[0], np.asarray(source), seconds=SECONDS, rate=RATE)
        write_wav(folder / f"audio_array_{array}.wav", audio, RATE)
        write_table(folder / f"audio_array_timestamps_{array}.txt", CLOCK, [clock(0.0)] * 3)
        header = [f"mic{n}_{axis}" for n in range(1, len(microphones) + 1) for axis in "xyz"]
        poses = [
            [*clock(t), *HEAD, *rotation[:, 1], *rotation.ravel(), *field.ravel()]
            for t, rotation, field in zip(times, rotations, fields, strict=True)
        ]
        write_table(folder / f"position_array_{array}.txt", [*POSE, *header], poses)
        for name in names:
            rows = [[*clock(t), *source, 0, 1, 0, *np.eye(3).ravel()] for t in times]
            write_table(folder / f"position_source_{name}.txt", POSE, rows)
        valid = [[*clock(t), 1] for t in times]
        write_table(folder / "required_time.txt", [*CLOCK, "valid_flag"], valid)
        return folder

    return add


@pytest.mark.parametrize("turn", [0.0, 130.0, -75.0])
def test_a_loudspeaker_is_heard_where_it_is_seen_from_the_turned_array(
    tmp_path: Path,
    add_recording: AddRecording,
    localize: Callable[[FloatArray, MicrophoneArray], float],
    turn: float,
) -> None:
    bearing, away = 25.0, 2.0  # degrees in the room, metres
    direction = [np.cos(np.deg2rad(bearing)), np.sin(np.deg2rad(bearing)), 0.0]
    four = RING[::3]
    add_recording(HEAD + away * np.array(direction), [turn] * 160, microphones=four, array="dummy")
    (item,) = LOCATA(tmp_path, "dummy").items("dev")
    # Unturned, the array's front is the room's y axis, 90 degrees.
    expected = (bearing - (90.0 + turn)) % 360
    (audio, azimuth), *_ = item.windows(16384, 16384)
    np.testing.assert_allclose(np.rad2deg(azimuth), [expected], atol=1e-3)
    assert item.audio.shape == (4, round(SECONDS * 16000))
    heard = np.rad2deg(localize(audio, item.array))
    assert abs((heard - expected + 180) % 360 - 180) < 1.5


def test_an_array_that_turns_hears_a_resting_source_move(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    # A degree counter-clockwise in every row.
    add_recording(AHEAD, np.arange(160.0), place="dev/task5/recording2")
    (item,) = LOCATA(tmp_path, "benchmark2").items("dev")
    found = np.rad2deg(item.directions.at(np.array([0.0, 0.5, 1.0]))[:, 0])
    # The first row is 4 ms, or 0.48 degrees, before the audio.
    np.testing.assert_allclose(found, [359.52, 299.52, 239.52], atol=1e-3)
    assert item.metadata["task"] == 5
    with pytest.raises(DatasetError, match="holds no recording"):
        next(LOCATA(tmp_path, "benchmark2", tasks=[1, 3]).items("dev"))


def test_a_source_above_keeps_its_azimuth_where_the_array_is_upright(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    add_recording(HEAD + np.array([-1.0, 1.0, 1.5]))
    (item,) = LOCATA(tmp_path, "benchmark2").items("dev")
    assert np.rad2deg(item.directions.at(np.array([0.5]))[0, 0]) == pytest.approx(45.0, abs=1e-3)


def test_invalid_rows_and_silence_are_unknown(tmp_path: Path, add_recording: AddRecording) -> None:
    folder = add_recording(AHEAD, names=("loudspeaker1", "loudspeaker3"))
    path = folder / "required_time.txt"
    header, *rows = path.read_text().splitlines()
    rows[:60] = [row[:-1] + "0" for row in rows[:60]]  # until 0.49 s
    path.write_text("\n".join([header, *rows]) + "\n")
    speaks = (np.arange(round(SECONDS * RATE)) < 0.8 * RATE).astype(int)
    vad = folder / "VAD_benchmark2_loudspeaker3.txt"
    vad.write_text("VAD\n" + "\n".join(map(str, speaks)) + "\n")
    (item,) = LOCATA(tmp_path, "benchmark2").items("dev")
    known = np.isfinite(item.directions.at(np.array([0.3, 0.6, 1.0])))
    assert known.tolist() == [[False, False], [True, True], [True, False]]
    assert item.metadata["sources"] == ["loudspeaker1", "loudspeaker3"]


def test_a_source_that_the_tracker_finds_late_is_unknown_before(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    folder = add_recording(AHEAD)
    path = folder / "position_source_loudspeaker1.txt"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[48:]]) + "\n")  # from 0.396 s
    (item,) = LOCATA(tmp_path, "benchmark2").items("dev")
    known = np.isfinite(item.directions.at(np.array([0.1, 0.3, 0.5, 1.1]))[:, 0])
    assert known.tolist() == [False, False, True, True]


def test_microphones_of_the_wide_array_too_far_out_are_left_out(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    wide = [[x, 0.0, 0.0] for x in np.linspace(-1.12, 1.12, 15)]
    add_recording(AHEAD, microphones=wide, array="dicit")
    (item,) = LOCATA(tmp_path, "dicit").items("dev")
    assert item.metadata["channels"] == list(range(1, 14))
    assert item.audio.shape[0] == item.array.num_microphones == 13
    # LOCATA's x is to the right: from first to last the microphones go from left to right.
    np.testing.assert_allclose(item.array.positions[[0, -1], 1], [0.96, -0.96], atol=1e-6)


def test_recordings_come_in_the_order_of_their_numbers(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    for number in (10, 2, 1):
        place = f"eval/task1/recording{number}"
        add_recording(AHEAD, place=place, microphones=RING[:4], array="dummy")
    names = [item.metadata["sequence"] for item in LOCATA(tmp_path, "dummy").items("eval")]
    assert names == [f"task1/recording{number}" for number in (1, 2, 10)]
    with pytest.raises(DatasetError, match="holds no recording of eigenmike"):
        next(LOCATA(tmp_path).items("eval"))


def test_published_folders_without_audio_are_passed_over(
    tmp_path: Path, add_recording: AddRecording
) -> None:
    wide = [[x, 0.0, 0.0] for x in np.linspace(-1.12, 1.12, 15)]
    for number in (3, 4):
        place = f"eval/task4/recording{number}"
        folder = add_recording(AHEAD, place=place, microphones=wide, array="dicit")
    (folder / "audio_array_dicit.wav").unlink()
    names = [item.metadata["sequence"] for item in LOCATA(tmp_path, "dicit").items("eval")]
    assert names == ["task4/recording3"]
    assert {fault.code for fault in LOCATA.verify(tmp_path)} == {"count"}


def spoil(folder: Path, name: str, old: str, new: str) -> None:
    path = folder / name
    path.write_text(path.read_text().replace(old, new, 1))


def test_faults_are_found_and_named(
    tmp_path: Path, add_recording: AddRecording, write_wav: Callable[..., None]
) -> None:
    folders = [add_recording(AHEAD, place=f"dev/task1/recording{number}") for number in range(1, 8)]
    (folders[0] / "position_source_loudspeaker1.txt").unlink()
    spoil(folders[1], "position_array_benchmark2.txt", "mic7_x", "mic7_east")
    spoil(folders[2], "required_time.txt", "\t1\n", "\t2\n")
    write_wav(folders[3] / "audio_array_benchmark2.wav", np.zeros((11, 100)), RATE)
    write_wav(folders[4] / "audio_array_benchmark2.wav", np.zeros((12, 100)), 16000)
    (folders[5] / "audio_array_timestamps_benchmark2.txt").unlink()
    spoil(folders[6], "position_source_loudspeaker1.txt", "2017\t6\t30", "2017\t6\t31")
    found = {
        fault.path.relative_to(tmp_path).parts[2]: (fault.code, fault.detail)
        for fault in LOCATA.verify(tmp_path)
        if fault.code != "count"
    }
    assert {place: code for place, (code, _) in found.items()} == {
        "recording1": "missing",
        "recording2": "annotation",
        "recording3": "annotation",
        "recording4": "channels",
        "recording5": "sample_rate",
        "recording6": "missing",
        "recording7": "annotation",
    }
    assert "download the final one" in found["recording1"][1]
    assert "names no column 'mic7_x'" in found["recording2"][1]
    assert "valid_flag is neither 0 nor 1" in found["recording3"][1]
    assert "a date is invalid" in found["recording7"][1]
    with pytest.raises(DatasetError, match="download the final one"):
        next(LOCATA(tmp_path, "benchmark2").items("dev"))
