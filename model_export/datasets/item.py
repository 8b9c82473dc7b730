"""One item type for all data sets: audio, its array, and the directions of the sources in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from model_export import SAMPLE_RATE
from model_export.datasets.fault import Count, Fault
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

MAX_GAP = 0.5
"""Longest gap in seconds over which annotations are interpolated; cameras and trackers give 25 to
120 a second"""


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions of M sources at K times; with K = 1 they are constant."""

    times: FloatArray
    """(K,) seconds from the audio's first sample, ascending"""
    azimuth: FloatArray
    """(K, M) radians, any wrap; NaN where a source is silent or its direction unknown"""

    def __post_init__(self) -> None:
        if self.azimuth.ndim != 2 or self.times.shape != self.azimuth.shape[:1]:
            raise ValueError(
                f"directions are (K,) times and (K, M) azimuths, not {self.times.shape} and "
                f"{self.azimuth.shape}"
            )
        if len(self.times) == 0:
            raise ValueError("directions need at least one time")

    @classmethod
    def constant(cls, azimuth: ArrayLike) -> Self:
        """Directions (M,), in radians, of sources that stand still and sound throughout."""
        return cls(np.zeros(1), np.atleast_1d(np.asarray(azimuth, dtype=np.float64))[None])

    def at(self, times: FloatArray) -> FloatArray:
        """Azimuths (Q, M) in [0, 2 pi) at times (Q,), interpolated along the shorter arc.

        They are NaN before the first annotation, after the last, between two that are more than
        ``MAX_GAP`` apart, and next to one that is NaN.
        """
        if len(self.times) == 1:
            return np.repeat(self.azimuth, len(times), axis=0) % (2 * np.pi)
        right = np.clip(np.searchsorted(self.times, times, "right"), 1, len(self.times) - 1)
        before, after = self.times[right - 1], self.times[right]
        gap = after - before
        share = np.clip((times - before) / np.where(gap > 0, gap, 1.0), 0.0, 1.0)[:, None]
        start, end = self.azimuth[right - 1], self.azimuth[right]
        arc = (end - start + np.pi) % (2 * np.pi) - np.pi
        # At an annotation its own value holds, even if its neighbour is NaN.
        turn = np.where(share > 0, share * arc, 0.0)
        azimuth = np.where(share == 1, end, start + turn) % (2 * np.pi)
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        near = (gap <= MAX_GAP) | (share[:, 0] == 0) | (share[:, 0] == 1)
        known: FloatArray = np.where((inside & near)[:, None], azimuth, np.nan)
        return known


@dataclass(frozen=True, slots=True, eq=False)
class DatasetItem:
    """One recording, or one simulated scene."""

    audio: FloatArray
    """(N, T) float32 at 16 kHz; channel n is microphone n"""
    array: MicrophoneArray
    """Array, in the frame of the azimuths"""
    directions: Directions
    metadata: dict[str, Any]
    """``dataset``, ``split``, ``sequence``, ``path``, ``licence``, and fields of the data set"""

    def __post_init__(self) -> None:
        if self.audio.ndim != 2 or self.audio.shape[0] != self.array.num_microphones:
            raise ValueError(
                f"audio of shape {self.audio.shape} for {self.array.num_microphones} microphones"
            )

    @property
    def duration(self) -> float:
        """Duration in seconds."""
        return self.audio.shape[1] / SAMPLE_RATE

    def windows(
        self, length_samples: int, hop_samples: int
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Windows and the known directions at their middles.

        Yields
        ------
        audio : (N, length_samples) float32
        azimuth : (M,) radians in [0, 2 pi)
            Sources whose direction is known then. Windows without any are left out.
        """
        starts = np.arange(0, self.audio.shape[1] - length_samples + 1, hop_samples)
        azimuths = self.directions.at((starts + length_samples / 2) / SAMPLE_RATE)
        for start, azimuth in zip(starts, azimuths, strict=True):
            known = azimuth[np.isfinite(azimuth)]
            if known.size:
                yield self.audio[:, start : start + length_samples], known


class Dataset(Protocol):
    """A data set on disk; audio is read when its item is iterated."""

    name: ClassVar[str]
    licence: ClassVar[str]
    source: ClassVar[str]
    """Authors and download"""
    layout: ClassVar[str]
    """Layout of the folder that it unpacks to"""
    splits: ClassVar[tuple[str, ...]]

    def items(self, split: str) -> Iterator[DatasetItem]:
        """Items of one split, always in the same order; DatasetError names a faulty file."""
        ...

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        """Whether the folder looks like this data set, complete or not."""
        ...

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        """Counts of what the folder holds."""
        ...

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        """All faults; audio is checked by its header, annotations are parsed."""
        ...


def check_split(dataset: Dataset, split: str) -> None:
    """Raise ValueError for a split that the data set does not have."""
    if split not in dataset.splits:
        raise ValueError(
            f"{dataset.name} has no split {split!r}: choose {' or '.join(dataset.splits)}"
        )
