"""The last results of a session, packed because they are kept for a long time."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

HISTORY = 6000
"""Most results that can be exported: ten minutes at 10 Hz"""
_HEAD = struct.Struct("<d?q")
_POINT = struct.Struct("<Idd?f")
LAST_TIME = 2**63 - 1
"""Latest capture time in nanoseconds; later ones are kept as none"""


@dataclass(frozen=True, slots=True)
class Point:
    """One source of one result."""

    id: int
    azimuth_deg: float
    confidence: float
    active: bool
    elevation_deg: float | None = None


@dataclass(frozen=True, slots=True)
class HistoryEntry:
    """One result as it is kept."""

    t_end: float
    capture_time_ns: int | None
    points: tuple[Point, ...]


class History:
    """The last ``HISTORY`` results; one with two sources takes 100 bytes, as objects 400."""

    def __init__(self) -> None:
        self._packed: deque[bytes] = deque(maxlen=HISTORY)

    def __len__(self) -> int:
        return len(self._packed)

    def __iter__(self) -> Iterator[HistoryEntry]:
        """The results, oldest first."""
        return map(_unpacked, self._packed)

    @property
    def last(self) -> HistoryEntry | None:
        """The newest result."""
        return _unpacked(self._packed[-1]) if self._packed else None

    def append(self, entry: HistoryEntry) -> None:
        """Add a result; the oldest one goes."""
        captured = max(-LAST_TIME, min(entry.capture_time_ns or 0, LAST_TIME))
        head = _HEAD.pack(entry.t_end, entry.capture_time_ns is not None, captured)
        points = (
            _POINT.pack(
                p.id,
                p.azimuth_deg,
                p.confidence,
                p.active,
                math.nan if p.elevation_deg is None else p.elevation_deg,
            )
            for p in entry.points
        )
        self._packed.append(head + b"".join(points))


def _unpacked(packed: bytes) -> HistoryEntry:
    t_end, captured, capture_time_ns = _HEAD.unpack_from(packed)
    points = tuple(
        Point(number, azimuth, chance, active, None if math.isnan(height) else round(height, 2))
        for number, azimuth, chance, active, height in _POINT.iter_unpack(packed[_HEAD.size :])
    )
    return HistoryEntry(t_end, capture_time_ns if captured else None, points)
