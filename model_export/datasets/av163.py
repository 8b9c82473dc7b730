"""AV16.3: people who speak and walk around a table with two rings of eight microphones."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from model_export import SAMPLE_RATE
from model_export.datasets.audio import check_audio, read_audio
from model_export.datasets.fault import (
    Count,
    DatasetError,
    Fault,
    collect,
    miscounts,
    require,
)
from model_export.datasets.item import DatasetItem, Directions, check_split
from model_export.datasets.table import read_table, sorted_times
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.types import FloatArray

Arrays = Literal["both", "1", "2"]

SEQUENCE = re.compile(r"seq\d{2}-(\d)p-[01]{4}")
TEST = ("seq08-1p-0100", "seq18-2p-0101")
ANNOTATED = (
    *("seq01-1p-0000", "seq02-1p-0000", "seq03-1p-0000", "seq08-1p-0100", "seq11-1p-0100"),
    *("seq12-1p-0100", "seq18-2p-0101", "seq19-2p-0101", "seq24-2p-0111", "seq25-2p-0111"),
    *("seq30-2p-1101", "seq45-3p-1111"),
)
"""Recordings, among 43, whose mouths are known to be published in three dimensions"""
MICROPHONES = 8
CENTRES = {"1": (0.0, 0.4, 0.0), "2": (0.0, -0.4, 0.0)}
"""Centres of the rings in metres, in the frame of the annotations"""
AUDIO_START = 10.0
"""Seconds of timecode at which audio starts; annotations are in timecode"""
TIME, POSITION = 0, slice(2, 5)
"""Columns of a .3dmouthgt file; the second is unused"""
MAX_LENGTH_DIFFERENCE = 0.1
"""Seconds by which channels of one recording may differ; a larger gap is a truncated file"""


class AV163:
    """Every annotated sequence is one item; a direction is known while a mouth is annotated.

    Silence is not annotated, so windows in pauses have directions, too.

    Parameters
    ----------
    arrays : str
        ``"both"`` is the paper's fusion: 16 microphones, directions from midway between the rings.
        ``"1"`` and ``"2"`` are one ring and directions from its own centre. One ring is the fairer
        task: the speakers are 1 to 3 m away, and both rings together are 1 m wide.
    """

    name: ClassVar[str] = "av163"
    licence: ClassVar[str] = "free to use, on condition that the paper is cited"
    source: ClassVar[str] = (
        "Lathoud, Odobez, Gatica-Perez, AV16.3: an Audio-Visual Corpus for Speaker Localization "
        "and Tracking, MLMI 2004; https://www.idiap.ch/dataset/av16-3, http://glat.info/ma/av16.3/"
    )
    layout: ClassVar[str] = (
        "<sequence>/<sequence>_array{1,2}_mic{1..8}.wav and "
        "<sequence>/<sequence>-person<i>-interpolated.3dmouthgt"
    )
    splits: ClassVar[tuple[str, ...]] = ("train", "test")

    def __init__(self, folder: Path, arrays: Arrays = "both") -> None:
        if arrays not in ("both", *CENTRES):
            raise ValueError(f"arrays is {arrays!r}: choose both, 1 or 2")
        self.folder = folder
        self.arrays = arrays

    def items(self, split: str) -> Iterator[DatasetItem]:
        check_split(self, split)
        sequences = [self.folder / name for name in TEST]
        if split == "train":
            sequences = [
                path
                for path in _sequences(self.folder)
                if path.name not in TEST and (path.name in ANNOTATED or _mouths(path))
            ]
        if not sequences:
            raise DatasetError(
                "missing", self.folder, f"holds no annotated sequence: expected {self.layout}"
            )
        for sequence in sequences:
            yield self._item(require(sequence, "download this sequence"), split)

    def _item(self, sequence: Path, split: str) -> DatasetItem:
        rings = tuple(CENTRES) if self.arrays == "both" else (self.arrays,)
        centre = np.mean([CENTRES[ring] for ring in rings], axis=0)
        audio = _read_channels([_microphone(sequence, *place) for place in _places(rings)])
        ring = preset("av163-circle8")
        array = ring
        if len(rings) > 1:
            positions = [ring.positions + np.array(CENTRES[name]) - centre for name in rings]
            array = MicrophoneArray("av163-both", np.concatenate(positions), ring.source)
        return DatasetItem(
            audio,
            array,
            _directions(sequence, centre, audio.shape[1] / SAMPLE_RATE),
            {
                "dataset": self.name,
                "split": split,
                "sequence": sequence.name,
                "path": str(sequence),
                "licence": self.licence,
                "arrays": self.arrays,
                "persons": _persons(sequence),
            },
        )

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return bool(_sequences(folder))

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        annotated = [path for path in _sequences(folder) if _mouths(path)]
        known = [path for path in annotated if path.name in ANNOTATED]
        return [
            Count("annotated sequences", len(known), (len(ANNOTATED),)),
            Count("recordings", len(_sequences(folder)), (43,), exact=False),
        ]

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        present = {path.name for path in _sequences(folder)}
        faults = miscounts(folder, cls.counts(folder))
        faults += [
            Fault("missing", folder / name, "is missing: download this sequence")
            for name in ANNOTATED
            if name not in present
        ]
        checked = [p for p in _sequences(folder) if p.name in ANNOTATED or _mouths(p)]
        for sequence in checked:
            paths = [_microphone(sequence, *place) for place in _places(tuple(CENTRES))]
            faults += collect(partial(check_audio, path, 1, SAMPLE_RATE) for path in paths)
            duration = _duration(paths[0])
            faults += collect(
                partial(_mouth, _mouth_file(sequence, person), duration)
                for person in range(1, _persons(sequence) + 1)
            )
        return faults


def _sequences(folder: Path) -> list[Path]:
    paths = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in paths if SEQUENCE.fullmatch(path.name) and path.is_dir())


def _persons(sequence: Path) -> int:
    """Number of persons, from the sequence's name."""
    match = SEQUENCE.fullmatch(sequence.name)
    return int(match[1]) if match else 0


def _places(rings: Sequence[str]) -> list[tuple[str, int]]:
    """Ring and number of every microphone, in the order of the channels."""
    return list(product(rings, range(1, MICROPHONES + 1)))


def _microphone(sequence: Path, ring: str, number: int) -> Path:
    return _below(sequence, f"{sequence.name}_array{ring}_mic{number}.wav")


def _mouth_file(sequence: Path, person: int) -> Path:
    return _below(sequence, f"{sequence.name}-person{person}-interpolated.3dmouthgt")


def _mouths(sequence: Path) -> list[Path]:
    return sorted(sequence.rglob(f"{sequence.name}-person*-interpolated.3dmouthgt"))


def _below(sequence: Path, name: str) -> Path:
    """The file in the sequence's folder, or in a subfolder as some mirrors have it."""
    path = sequence / name
    return path if path.exists() else next(iter(sorted(sequence.rglob(name))), path)


def _read_channels(paths: Sequence[Path]) -> FloatArray:
    """Audio (N, T) of files with one microphone each."""
    channels = [read_audio(path, 1)[0] for path in paths]
    lengths = [len(channel) for channel in channels]
    shortest = int(np.argmin(lengths))
    if max(lengths) - lengths[shortest] > MAX_LENGTH_DIFFERENCE * SAMPLE_RATE:
        raise DatasetError(
            "audio",
            paths[shortest],
            f"lasts {lengths[shortest] / SAMPLE_RATE:.2f} s, another microphone "
            f"{max(lengths) / SAMPLE_RATE:.2f} s: download the file again",
        )
    return np.stack([channel[: lengths[shortest]] for channel in channels])


def _duration(path: Path) -> float:
    """Seconds of audio; infinite if it cannot be read, which is a fault of its own."""
    try:
        return check_audio(path, 1, SAMPLE_RATE)
    except DatasetError:
        return np.inf


def _mouth(path: Path, duration: float) -> tuple[FloatArray, FloatArray]:
    """Times (K,) in seconds of the audio and positions (K, 3) in metres."""
    rows = read_table(path, POSITION.stop)
    # Rounded, so that one camera frame has the same time for every person.
    times = sorted_times(path, (rows[:, TIME] - AUDIO_START).round(6))
    if times[-1] < 0 or times[0] > duration:
        raise DatasetError(
            "annotation",
            path,
            f"its times {rows[0, TIME]:g} to {rows[-1, TIME]:g} s are outside the audio, "
            f"{AUDIO_START:g} to {duration + AUDIO_START:g} s: is it another sequence's?",
        )
    return times, rows[:, POSITION]


def _directions(sequence: Path, centre: FloatArray, duration: float) -> Directions:
    """Directions of all persons, at every time that has a row for one of them."""
    people = []
    for person in range(1, _persons(sequence) + 1):
        times, mouth = _mouth(_mouth_file(sequence, person), duration)
        offset = mouth - centre
        people.append(Directions(times, np.arctan2(offset[:, 1], offset[:, 0])[:, None]))
    times = np.unique(np.concatenate([person.times for person in people]))
    return Directions(times, np.concatenate([person.at(times) for person in people], axis=1))
