"""Analysis windows cut from a stream of audio blocks, with memory for one window and one block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from service.doa.types import FloatArray


@dataclass(frozen=True, slots=True)
class Window:
    """One analysis window."""

    start: float
    """Seconds from the beginning of the recording"""
    audio: FloatArray
    """(N, T) float32, zero-padded where the recording ends inside"""
    heard: int
    """Samples of it that the recording really holds"""


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
            yield Window(index * hop_s, buffer[:, begin : begin + needed], length)
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
        yield Window(index * hop_s, padded, min(length, total - start))
        index += 1
