"""LOCATA's text files: start of the audio, poses of the array, positions and speech of sources."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from model_export.datasets.fault import DatasetError
from model_export.datasets.table import read_table, sorted_times
from service.doa.types import BoolArray, FloatArray, IntArray

CLOCK = ("year", "month", "day", "hour", "minute", "second")
POSITION = ("x", "y", "z")
ROTATION = tuple(f"rotation_{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
FRONT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from LOCATA's axes (x right, y front) to ours (x front, y left)"""
MAX_TIME_DIFFERENCE = 0.05
"""Seconds between a row of the array and its nearest row of a source: six tracker frames"""
ORTHOGONAL = 1e-3


@dataclass(frozen=True, slots=True)
class ArrayPose:
    """Pose of an array at K times, and its microphones in its own frame."""

    times: FloatArray
    """(K,) seconds since the year 1"""
    position: FloatArray
    """(K, 3) metres in the room"""
    rotation: FloatArray
    """(K, 3, 3) rotation from LOCATA's array frame to the room's"""
    microphones: FloatArray
    """(N, 3) metres in the array's frame, x front"""

    def azimuth(self, times: FloatArray, position: FloatArray) -> FloatArray:
        """Azimuths (K,) in radians of a source with positions (Q, 3) at its own times (Q,).

        They are NaN where the source has no row near in time, or a coordinate is unknown.
        """
        row = _nearest(times, self.times)
        offset = np.einsum("kij,ki->kj", self.rotation, position[row] - self.position) @ FRONT.T
        azimuth = np.arctan2(offset[:, 1], offset[:, 0])
        near = np.abs(times[row] - self.times) <= MAX_TIME_DIFFERENCE
        known: FloatArray = np.where(near, azimuth, np.nan)
        return known


def read_array_pose(path: Path, channels: int) -> ArrayPose:
    """Read ``position_array_<array>.txt``; DatasetError if malformed or without a valid row."""
    names = [f"mic{number}_{axis}" for number in range(1, channels + 1) for axis in POSITION]
    rows = read_table(path, (*CLOCK, *POSITION, *ROTATION, *names), delimiter="\t")
    clock, position, rotation, microphones = np.split(rows, np.cumsum([6, 3, 9]), axis=1)
    rotation = rotation.reshape(-1, 3, 3)
    microphones = microphones.reshape(len(rows), channels, 3)
    whole = np.flatnonzero(np.isfinite(rows).all(axis=1))
    if whole.size == 0:
        raise DatasetError("annotation", path, "holds no row without NaN: unpack it again")
    first = whole[0]
    if np.abs(rotation[first] @ rotation[first].T - np.eye(3)).max() > ORTHOGONAL:
        raise DatasetError("annotation", path, "its rotation is not orthogonal: unpack it again")
    # The array is rigid: one row gives all microphone positions.
    own = (microphones[first] - position[first]) @ rotation[first] @ FRONT.T
    return ArrayPose(_seconds(path, clock), position, rotation, own)


def read_source_position(path: Path) -> tuple[FloatArray, FloatArray]:
    """``position_source_<source>.txt``: seconds (Q,) since the year 1, positions (Q, 3) in m."""
    rows = read_table(path, (*CLOCK, *POSITION), delimiter="\t")
    return _seconds(path, rows[:, :6]), rows[:, 6:]


def read_valid(path: Path) -> BoolArray:
    """``required_time.txt``: whether each row (K,) of the positions is valid."""
    return _flags(path, "valid_flag")


def audio_start(path: Path) -> float:
    """``audio_array_timestamps_<array>.txt``: the first sample's time, seconds since the year 1."""
    return float(_seconds(path, read_table(path, CLOCK, delimiter="\t", max_rows=1))[0])


def voice_activity(path: Path) -> BoolArray | None:
    """``VAD_<array>_<source>.txt``: whether the source speaks (T,), sample by sample of the audio.

    None where there is no such file.
    """
    return _flags(path, "VAD") if path.exists() else None


def _flags(path: Path, column: str) -> BoolArray:
    values = read_table(path, (column,), delimiter="\t")[:, 0]
    if not np.isin(values, (0, 1)).all():
        raise DatasetError("annotation", path, f"{column} is neither 0 nor 1: unpack it again")
    return values == 1


def _nearest(times: FloatArray, wanted: FloatArray) -> IntArray:
    """Index (K,) of the time (Q,) that is nearest to every wanted time (K,)."""
    right = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    right = np.minimum(right, len(times) - 1)
    left = np.maximum(right - 1, 0)
    nearest: IntArray = np.where(wanted - times[left] <= times[right] - wanted, left, right)
    return nearest


def _seconds(path: Path, clock: FloatArray) -> FloatArray:
    """Seconds (K,) since the year 1 of calendar times (K, 6), exact to 8 microseconds."""
    try:
        days = [date(*map(int, row[:3])).toordinal() for row in clock]
    except (ValueError, OverflowError):
        raise DatasetError("annotation", path, "a date is invalid: unpack it again") from None
    seconds = np.array(days) * 86400.0 + clock[:, 3:] @ np.array([3600.0, 60.0, 1.0])
    return sorted_times(path, seconds)
