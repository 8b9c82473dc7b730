"""LOCATA: loudspeakers and walking talkers, four arrays, tracked by cameras."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from model_export.datasets.audio import check_audio, read_audio
from model_export.datasets.fault import Count, DatasetError, Fault, collect, miscounts, require
from model_export.datasets.item import DatasetItem, Directions, check_split
from model_export.datasets.locata_poses import (
    ArrayPose,
    audio_start,
    read_array_pose,
    read_source_position,
    read_valid,
    voice_activity,
)
from service.doa.array import MAX_APERTURE, MicrophoneArray
from service.doa.types import FloatArray, IntArray

ARRAYS = {"dicit": 15, "benchmark2": 12, "eigenmike": 32, "dummy": 4}
"""Channels by array: planar, a robot's head, a sphere, hearing aids on a dummy head"""
SAMPLE_RATE = 48_000
WITHOUT_AUDIO = {("eval", 4, 4, "dicit"), ("eval", 6, 5, "dicit")}
"""Folders without audio in the challenge's first release"""
AUDIO_FILES = {"dev": (72,), "eval": (154, 156)}
"""Published numbers of audio files; eval has 156 where ``WITHOUT_AUDIO`` has audio"""
SOURCE_REMEDY = "the challenge's first release has none for eval, download the final one"


class LOCATA:
    """Every recording of one array is one item, whose sources' directions may change in time.

    Azimuths are LOCATA's own: 0 at the array's front, its y axis, counter-clockwise; x of the
    item's array is LOCATA's y. The frame moves with the array (tasks 5 and 6). A direction is known
    where ``required_time.txt`` says that it is valid and, if there is a VAD file, where the source
    speaks; the early release has no VAD files.

    Parameters
    ----------
    array : str
        A name in ``ARRAYS``. Microphones of ``dicit``, which is 2.2 m wide, are left out if they
        are further than 1 m from its reference point.
    tasks : sequence of int
        1 and 2 are static, 3 and 4 have moving talkers, in 5 and 6 the array moves, too; 2, 4 and 6
        have several sources.
    """

    name: ClassVar[str] = "locata"
    licence: ClassVar[str] = "ODC-BY 1.0"
    source: ClassVar[str] = (
        "Evers et al., The LOCATA Challenge: Acoustic Source Localization and Tracking, IEEE/ACM "
        "TASLP 28, 2020, arXiv 1909.01008; https://doi.org/10.5281/zenodo.3630470"
    )
    layout: ClassVar[str] = (
        "{dev,eval}/task<n>/recording<n>/<array>/ with audio_array_<array>.wav, "
        "audio_array_timestamps_<array>.txt, position_array_<array>.txt, "
        "position_source_<source>.txt, required_time.txt"
    )
    splits: ClassVar[tuple[str, ...]] = ("dev", "eval")

    def __init__(
        self, folder: Path, array: str = "eigenmike", tasks: Sequence[int] = (1, 2, 3, 4, 5, 6)
    ) -> None:
        if array not in ARRAYS:
            raise ValueError(f"array is {array!r}: choose {', '.join(ARRAYS)}")
        self.folder = folder
        self.array = array
        self.tasks = tuple(tasks)

    def items(self, split: str) -> Iterator[DatasetItem]:
        check_split(self, split)
        found = [
            recording
            for recording in _recordings(self.folder, split)
            if recording.parent.parent.name in {f"task{task}" for task in self.tasks}
            and recording.name == self.array
        ]
        if not found:
            raise DatasetError(
                "missing",
                self.folder / split,
                f"holds no recording of {self.array}: expected {self.layout}",
            )
        for recording in found:
            if not _without_audio(recording):
                yield self._item(recording, split)

    def _item(self, recording: Path, split: str) -> DatasetItem:
        pose, directions = _annotations(recording)
        channels, array = _near_microphones(self.array, pose)
        return DatasetItem(
            read_audio(_audio(recording), ARRAYS[self.array], tuple(channels.tolist())),
            array,
            directions,
            {
                "dataset": self.name,
                "split": split,
                "sequence": f"{recording.parent.parent.name}/{recording.parent.name}",
                "path": str(recording),
                "licence": self.licence,
                "task": int(recording.parent.parent.name.removeprefix("task")),
                "array": self.array,
                "channels": channels.tolist(),
                "sources": [_source_name(path) for path in _sources(recording)],
            },
        )

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return any(_recordings(folder, split) for split in cls.splits)

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        return [
            Count(
                f"audio files of {split}",
                sum(_audio(recording).exists() for recording in _recordings(folder, split)),
                published,
            )
            for split, published in AUDIO_FILES.items()
        ]

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        faults = miscounts(folder, cls.counts(folder))
        for split in cls.splits:
            for recording in _recordings(folder, split):
                if not _without_audio(recording):
                    channels = ARRAYS[recording.name]
                    audio = partial(check_audio, _audio(recording), channels, SAMPLE_RATE)
                    faults += collect([audio, partial(_annotations, recording)])
        return faults


def _recordings(folder: Path, split: str) -> list[Path]:
    """Folders with one array's recording, in the order of task and number."""
    return sorted(
        (
            path
            for path in folder.glob(f"{split}/task[1-6]/recording*/*")
            if path.name in ARRAYS and path.is_dir()
        ),
        key=_place,
    )


def _place(recording: Path) -> tuple[str, int, int, str]:
    split, task, number, array = recording.parts[-4:]
    numbers = [int(re.sub(r"\D", "", name) or 0) for name in (task, number)]
    return split, numbers[0], numbers[1], array


def _without_audio(recording: Path) -> bool:
    return _place(recording) in WITHOUT_AUDIO and not _audio(recording).exists()


def _audio(recording: Path) -> Path:
    return recording / f"audio_array_{recording.name}.wav"


def _source_name(path: Path) -> str:
    return path.stem.removeprefix("position_source_")


def _sources(recording: Path) -> list[Path]:
    paths = sorted(recording.glob("position_source_*.txt"))
    return paths or [require(recording / "position_source_*.txt", SOURCE_REMEDY)]


def _near_microphones(name: str, pose: ArrayPose) -> tuple[IntArray, MicrophoneArray]:
    """Channels of the microphones near the reference point, and the array of these."""
    distance = np.linalg.norm(pose.microphones, axis=1)
    channels = np.flatnonzero(distance <= MAX_APERTURE / 2)
    return channels, MicrophoneArray(
        f"locata-{name}", pose.microphones[channels], "position_array of the recording"
    )


def _annotations(recording: Path) -> tuple[ArrayPose, Directions]:
    """The array's pose, and the directions of all sources at its times."""
    name = recording.name
    pose = read_array_pose(recording / f"position_array_{name}.txt", ARRAYS[name])
    times: FloatArray = pose.times - audio_start(recording / f"audio_array_timestamps_{name}.txt")
    sources = _sources(recording)
    azimuth = np.stack([pose.azimuth(*read_source_position(path)) for path in sources], axis=1)
    path = recording / "required_time.txt"
    valid = read_valid(path)
    # Rows are paired by number, as in the official evaluation; their times differ by rounding.
    if len(valid) != len(azimuth):
        raise DatasetError(
            "annotation",
            path,
            f"has {len(valid)} rows, position_array {len(azimuth)}: unpack the recording again",
        )
    azimuth[~valid] = np.nan
    for column, source in enumerate(sources):
        active = voice_activity(recording / f"VAD_{name}_{_source_name(source)}.txt")
        if active is not None:
            sample = np.clip(np.round(times * SAMPLE_RATE), 0, len(active) - 1).astype(np.int64)
            azimuth[~active[sample], column] = np.nan
    return pose, Directions(times, azimuth)
