"""Tracks of real recordings whose talkers' directions are known.

A folder holds recordings of the evaluation's array and ``labels.json`` with
``{"recordings": {"FILE": {"azimuth_deg": [...]}}}``. The labels do not say who speaks when, so
tracks are judged by direction, not by time.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from service.doa.scoring import circular_error
from service.doa.tracking import Detection, Tracker
from service.doa.types import FloatArray

TOLERANCE = np.deg2rad(15.0)
LASTING_S = 1.0
"""Seconds for which an id must be active to be counted"""

Estimates = Callable[[FloatArray, float], Iterable[tuple[float, list[Detection]]]]
"""Turns audio (N, T) at 16 kHz and an interval in seconds into times and detections"""


@dataclass(frozen=True, slots=True)
class RealTracks:
    """Counts of what is reported over one recording."""

    talkers: int
    reported: int
    """Active tracks of all results"""
    near: int
    """Reported tracks within 15 degrees of a talker"""
    ids: int
    """Ids that were active for ``LASTING_S`` or longer"""


def real_tracks(folder: Path, estimates: Estimates, interval: float) -> dict[str, RealTracks]:
    """Tracks of every labelled recording by its name.

    Raises
    ------
    FileNotFoundError
        If the folder holds no ``labels.json``, or a recording is missing.
    ValueError
        If a recording has another sample rate than the models.
    """
    labels = json.loads((folder / "labels.json").read_text())["recordings"]
    return {
        name: _follow(_read(folder / name), np.deg2rad(label["azimuth_deg"]), estimates, interval)
        for name, label in labels.items()
    }


def _read(path: Path) -> FloatArray:
    audio, rate = soundfile.read(path, dtype="float32", always_2d=True)
    if rate != SAMPLE_RATE:
        raise ValueError(f"{path} is at {rate} Hz: resample it to {SAMPLE_RATE} Hz")
    channels: FloatArray = np.ascontiguousarray(audio.T)
    return channels


def _follow(
    audio: FloatArray, talkers: FloatArray, estimates: Estimates, interval: float
) -> RealTracks:
    tracker = Tracker()
    active: Counter[int] = Counter()
    near = 0
    for time, detections in estimates(audio, interval):
        for track in tracker.update(detections, time):
            if track.active:
                active[track.id] += 1
                error = circular_error(np.array(track.azimuth), talkers).min()
                near += int(error <= TOLERANCE)
    lasting = sum(count * interval >= LASTING_S for count in active.values())
    return RealTracks(len(talkers), active.total(), near, lasting)


def real_table(found: Mapping[str, RealTracks]) -> str:
    """The recordings as a Markdown table."""
    lines = [
        "| recording | talkers | ids of a second or more | active tracks within 15° of a talker |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {each.talkers} | {each.ids} | {each.near} of {each.reported} |"
        for name, each in found.items()
    ]
    return "\n".join(lines) + "\n"
