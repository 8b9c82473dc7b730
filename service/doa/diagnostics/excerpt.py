"""The loud seconds of a recording, on which all but the levels is judged.

A fixed number of slots divides the recording's time so far, and each keeps its loudest segment.
When the slots are full, neighbours merge and every slot covers twice the time. Memory is bounded,
the excerpt spreads over the whole recording, and pauses do not fill it.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

import numpy as np
import numpy.typing as npt

from service.doa.types import FloatArray

SEGMENT_S = 0.5  # long against a room's delays, short against a turn of speech
SLOTS = 24  # 12 s: enough cells for every test, and 3 MB for eight channels at 16 kHz
FULL_SCALE = 32767


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of audio and its power, stored with 16 bits below every channel's own peak."""

    samples: npt.NDArray[np.int16]
    """(N, T) samples in steps"""
    step: FloatArray
    """(N, 1) size of a step"""
    power: float

    @classmethod
    def of(cls, audio: FloatArray, power: float) -> Segment:
        """The segment of audio (N, T)."""
        peak = np.abs(audio).max(axis=-1, keepdims=True)
        step = np.maximum(peak, np.finfo(np.float32).tiny) / np.float32(FULL_SCALE)
        return cls(np.rint(audio / step).astype(np.int16), step, power)

    @property
    def audio(self) -> FloatArray:
        """(N, T) float32."""
        audio: FloatArray = self.samples * self.step
        return audio


class Excerpt:
    """Collects the loudest segment of every slot."""

    def __init__(self, sample_rate: int, num_channels: int) -> None:
        self._length = max(1, round(SEGMENT_S * sample_rate))
        self._rest: FloatArray = np.zeros((num_channels, 0), dtype=np.float32)
        self._slots: list[Segment] = []
        self._in_last = 0  # segments that the last slot has seen
        self._per_slot = 1

    def add(self, block: FloatArray) -> None:
        """Add a block (N, T) of any length."""
        audio = np.concatenate([self._rest, block], axis=-1) if self._rest.size else block
        whole = audio.shape[-1] // self._length * self._length
        for start in range(0, whole, self._length):
            self._offer(audio[:, start : start + self._length])
        self._rest = audio[:, whole:].copy()

    def segments(self) -> list[FloatArray]:
        """The kept segments (N, T) in time order; a short recording is one short segment."""
        if not self._slots:
            return [self._rest] if self._rest.shape[-1] else []
        return [segment.audio for segment in self._slots]

    def loudest(self) -> float:
        """Power of the loudest segment in the median channel."""
        if self._slots:
            return max(segment.power for segment in self._slots)
        return _power(self._rest) if self._rest.shape[-1] else 0.0

    def _offer(self, audio: FloatArray) -> None:
        power = _power(audio)
        if self._slots and self._in_last < self._per_slot:
            self._in_last += 1
            if power > self._slots[-1].power:
                self._slots[-1] = Segment.of(audio, power)
            return
        if len(self._slots) == SLOTS:
            self._merge()
        self._slots.append(Segment.of(audio, power))
        self._in_last = 1

    def _merge(self) -> None:
        pairs = zip(self._slots[::2], self._slots[1::2], strict=True)
        self._slots = [max(pair, key=lambda segment: segment.power) for pair in pairs]
        self._per_slot *= 2


def _power(audio: FloatArray) -> float:
    """Variance of the median channel, so that one dead or hot channel does not choose segments."""
    around = audio - audio.mean(axis=-1, keepdims=True)
    return float(median(np.vecdot(around, around) / audio.shape[-1]))
