"""Analysis windows cut from a stream of audio blocks, with memory for one window and one block.

Overlapping windows are joined to stretches, which hold shared audio once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from service.doa.types import ComplexArray, FloatArray

Numbers = TypeVar("Numbers", FloatArray, ComplexArray)


@dataclass(frozen=True, slots=True)
class Window:
    """One analysis window."""

    start: float
    """Seconds from the beginning of the recording"""
    first: int
    """Samples from the beginning of the recording"""
    audio: FloatArray
    """(N, T) float32, zero-padded where the recording ends inside"""
    heard: int
    """Samples of the window that the recording really holds"""


def windows(
    blocks: Iterable[FloatArray], sample_rate: int, window_s: float, hop_s: float, tail: int
) -> Iterator[Window]:
    """Cut blocks (N, T) into windows that begin every ``hop_s`` seconds.

    A recording no longer than a window is one padded window; a longer one ends with the first
    window that reaches its end.

    Parameters
    ----------
    tail : int
        Samples past a window's end that its last STFT frame still reads.
    """
    length = round(window_s * sample_rate)
    needed = length + tail
    buffer: FloatArray | None = None
    offset = 0  # of the buffer in the recording, samples
    index = 0
    for block in blocks:
        buffer = block if buffer is None else np.concatenate([buffer, block], axis=1)
        while offset + buffer.shape[1] >= (start := round(index * hop_s * sample_rate)) + needed:
            begin = start - offset
            yield Window(index * hop_s, start, buffer[:, begin : begin + needed], length)
            index += 1
        passed = min(max(0, round(index * hop_s * sample_rate) - offset), buffer.shape[1])
        buffer, offset = buffer[:, passed:], offset + passed
    if buffer is None:
        return
    total = offset + buffer.shape[1]
    while (start := round(index * hop_s * sample_rate)) < total:
        if index and round((index - 1) * hop_s * sample_rate) + length >= total:
            return
        audio = buffer[:, start - offset : start - offset + needed]
        padded = np.pad(audio, [(0, 0), (0, needed - audio.shape[1])])
        yield Window(index * hop_s, start, padded, min(length, total - start))
        index += 1


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive windows and the audio that they lie in."""

    starts: tuple[float, ...]
    """Start of every window in seconds"""
    heard: tuple[int, ...]
    """Samples of every window that the recording really holds"""
    audio: FloatArray
    """(N, T) float32, contiguous, from the first window's start to the last one's end"""
    length: int
    """Samples of a window"""
    hop: int
    """Samples from the start of one window to the start of the next"""

    def without_last(self) -> Stretch:
        """All but the last window."""
        audio = np.ascontiguousarray(self.audio[:, : -self.hop])
        return replace(self, starts=self.starts[:-1], heard=self.heard[:-1], audio=audio)

    @property
    def windows(self) -> FloatArray:
        """(B, N, length) float32, a view."""
        return sliding(self.audio, self.length, self.hop)


def sliding(values: Numbers, length: int, hop: int) -> Numbers:
    """A view of (..., T) as pieces (B, ..., length) that begin every ``hop``."""
    pieces = np.lib.stride_tricks.sliding_window_view(values, length, axis=-1)
    moved: Numbers = np.moveaxis(pieces[..., ::hop, :], -2, 0)
    return moved


def stretches(cut: Iterable[Window], most: int) -> Iterator[Stretch]:
    """Join at most ``most`` windows at a time, while they overlap at one distance."""
    joined: list[Window] = []
    for window in cut:
        if joined and (len(joined) == most or not _continues(joined, window)):
            yield _stretch(joined)
            joined = []
        joined.append(window)
    if joined:
        yield _stretch(joined)


def _continues(joined: list[Window], window: Window) -> bool:
    hop = window.first - joined[-1].first
    return hop < window.audio.shape[1] and (len(joined) == 1 or hop == _hop(joined))


def _hop(joined: list[Window]) -> int:
    """Samples between the first two windows; for a single window its length."""
    return joined[1].first - joined[0].first if len(joined) > 1 else joined[0].audio.shape[1]


def _stretch(joined: list[Window]) -> Stretch:
    hop, last = _hop(joined), joined[-1].audio
    audio = np.concatenate([*(window.audio[:, :hop] for window in joined[:-1]), last], axis=1)
    return Stretch(
        tuple(window.start for window in joined),
        tuple(window.heard for window in joined),
        audio,
        last.shape[1],
        hop,
    )
