"""AFPILD: the footsteps of 40 people who walk around four microphones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import ClassVar, Literal, get_args

import numpy as np

from model_export import SAMPLE_RATE
from model_export.datasets.audio import check_audio, read_audio
from model_export.datasets.fault import (
    REMEDY,
    Count,
    DatasetError,
    Fault,
    collect,
    miscounts,
)
from model_export.datasets.item import DatasetItem, Directions, check_split
from model_export.datasets.table import read_table
from service.doa.presets import preset
from service.doa.types import FloatArray, IntArray

Variant = Literal["cloth", "shoe", "rd"]

ARRAY = preset("respeaker-usb-4mic-v2")
"""Array assumed by the NeuralMUSIC paper's code; the data set does not name it"""
CHANNELS = 4
SUBJECTS = range(1, 41)
SESSIONS = range(1, 5)
"""Sessions: coat, anticlockwise; no coat, clockwise; other shoes, anticlockwise; lab coat,
clockwise"""
TRAIN_SESSIONS = {"cloth": (1, 4), "shoe": (1, 2)}
EVENTS = 62_174
FIRST, UNUSED = 5, 3
"""First used row and number of unused last rows, as in the authors' code"""


class AFPILD:
    """Every footstep is one item with one constant direction.

    The annotated zero is not the array's: see ``offset``.

    Parameters
    ----------
    variant : str
        ``"cloth"`` trains on sessions 1 and 4 and tests on 2 and 3, ``"shoe"`` on 1 and 2, and 3
        and 4; ``"rd"`` takes half of every session's footsteps at random, always the same.
    seconds : float, optional
        Length of the audio around each footstep's middle, kept inside the session; by default the
        audio lasts from the footstep's boundary to the next, some 0.6 s.
    """

    name: ClassVar[str] = "afpild"
    licence: ClassVar[str] = "CC BY-NC-SA 4.0"
    source: ClassVar[str] = (
        "Wu et al., Acoustic footstep-based person identification and localization, Information "
        "Fusion 104, 2024; links at https://github.com/Cratial/AFPILD-CRNN"
    )
    layout: ClassVar[str] = (
        "AFPILD_v1/S<nn>/s<nn>_{1..4}_footstep_audio.wav, 4 channels, and "
        "s<nn>_{1..4}_footstep_annotation.csv (sample_loc, loc_x, loc_y)"
    )
    splits: ClassVar[tuple[str, ...]] = ("train", "test")

    def __init__(
        self, folder: Path, variant: Variant = "cloth", seconds: float | None = None
    ) -> None:
        if variant not in get_args(Variant):
            raise ValueError(f"variant is {variant!r}: choose cloth, shoe or rd")
        self.folder = folder
        self.variant = variant
        self.seconds = seconds

    def items(self, split: str) -> Iterator[DatasetItem]:
        check_split(self, split)
        root = _root(self.folder)
        if root is None:
            raise DatasetError("missing", self.folder, f"holds no S01/: expected {self.layout}")
        for subject, session in product(SUBJECTS, self._sessions(split)):
            if (root / f"S{subject:02d}").is_dir():
                yield from self._session(root, split, subject, session)

    def _session(self, root: Path, split: str, subject: int, session: int) -> Iterator[DatasetItem]:
        boundaries, azimuth = _events(_path(root, subject, session, "annotation.csv"))
        path = _path(root, subject, session, "audio.wav")
        audio = read_audio(path, CHANNELS)
        _check_boundaries(path, boundaries, audio.shape[1])
        for event in self._chosen(split, subject, session, len(azimuth)):
            start, end = self._extent(boundaries[event], boundaries[event + 1], audio.shape[1])
            yield DatasetItem(
                audio[:, start:end],
                ARRAY,
                Directions.constant(azimuth[event]),
                {
                    "dataset": self.name,
                    "split": split,
                    "sequence": f"s{subject:02d}_{session}",
                    "path": str(path),
                    "licence": self.licence,
                    "speaker": f"S{subject:02d}",
                    "session": session,
                    "event": int(event) + FIRST,
                    "start_sample": int(start),
                },
            )

    def _sessions(self, split: str) -> Sequence[int]:
        if self.variant == "rd":
            return SESSIONS
        train = TRAIN_SESSIONS[self.variant]
        return [session for session in SESSIONS if (session in train) == (split == "train")]

    def _chosen(self, split: str, subject: int, session: int, events: int) -> IntArray:
        """Events of one session that belong to the split, ascending."""
        if self.variant != "rd":
            return np.arange(events)
        order = np.random.default_rng([subject, session]).permutation(events)
        half = order[: events // 2] if split == "train" else order[events // 2 :]
        return np.sort(half)

    def _extent(self, first: int, last: int, samples: int) -> tuple[int, int]:
        if self.seconds is None:
            return first, last
        length = min(round(self.seconds * SAMPLE_RATE), samples)
        start = min(max((first + last - length) // 2, 0), samples - length)
        return start, start + length

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return _root(folder) is not None

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        root = _root(folder)
        tables = sorted(root.glob("S*/s*_footstep_annotation.csv")) if root is not None else []
        events = 0
        for path in tables:
            with suppress(DatasetError):  # a fault of its own
                events += len(_events(path)[1])
        return [
            Count("sessions", len(tables), (len(SUBJECTS) * len(SESSIONS),)),
            Count("footsteps", events, (EVENTS,), exact=False),
        ]

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        root = _root(folder)
        if root is None:
            return [Fault("missing", folder / "AFPILD_v1", f"is missing: expected {cls.layout}")]
        faults = miscounts(root, cls.counts(folder))
        for session in product(SUBJECTS, SESSIONS):
            audio = _path(root, *session, "audio.wav")
            table = _path(root, *session, "annotation.csv")
            found = collect([partial(check_audio, audio, CHANNELS), partial(_events, table)])
            faults += found or collect([partial(_check_session, audio, table)])
        return faults


def _root(folder: Path) -> Path | None:
    roots = (folder, folder / "AFPILD_v1")
    return next((root for root in roots if any(root.glob("S[0-4][0-9]/s*_footstep_*"))), None)


def _path(root: Path, subject: int, session: int, kind: str) -> Path:
    return root / f"S{subject:02d}" / f"s{subject:02d}_{session}_footstep_{kind}"


def _events(path: Path) -> tuple[IntArray, FloatArray]:
    """Boundaries (E + 1,) in samples and azimuths (E,) in radians of the footsteps used."""
    rows = read_table(path, ("sample_loc", "loc_x", "loc_y"), delimiter=",")
    if len(rows) <= FIRST + UNUSED:
        raise DatasetError(
            "annotation",
            path,
            f"has {len(rows)} rows, a session has hundreds: {REMEDY}",
        )
    used = rows[FIRST : len(rows) - UNUSED + 1]
    if not np.isfinite(used).all() or (np.diff(used[:, 0]) <= 0).any() or used[0, 0] < 0:
        raise DatasetError(
            "annotation", path, f"sample_loc does not ascend, or a value is no number: {REMEDY}"
        )
    return used[:, 0].astype(np.int64), np.arctan2(used[:-1, 2], used[:-1, 1])


def _check_session(audio: Path, table: Path) -> None:
    samples = round(check_audio(audio, CHANNELS) * SAMPLE_RATE)
    _check_boundaries(audio, _events(table)[0], samples)


def _check_boundaries(path: Path, boundaries: IntArray, samples: int) -> None:
    if boundaries[-1] > samples:
        raise DatasetError(
            "audio",
            path,
            f"lasts {samples / SAMPLE_RATE:.1f} s, but footsteps are annotated until "
            f"{boundaries[-1] / SAMPLE_RATE:.1f} s: {REMEDY}",
        )
