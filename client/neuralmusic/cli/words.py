"""Directions, times and columns as text for the command line."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Optional

if TYPE_CHECKING:
    from neuralmusic.protocol.server_messages import StreamSource

SECTORS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")


def sector(azimuth: float) -> str:
    """An azimuth in radians as a direction in words: 0 is the front, left comes next."""
    return SECTORS[round(azimuth / (math.pi / 4)) % len(SECTORS)]


def degrees(azimuth: float) -> str:
    """Radians as ``45°``; 359.9 degrees are 0, not 360."""
    return f"{round(math.degrees(azimuth)) % 360}°"


def direction(azimuth: float, elevation: Optional[float] = None) -> str:
    """A direction in radians as ``45°``, or ``45° +10°`` with an elevation."""
    height = "" if elevation is None else f" {round(math.degrees(elevation)):+d}°"
    return degrees(azimuth) + height


def radians(source: StreamSource) -> tuple[float, Optional[float]]:
    """Azimuth and elevation of a stream's source in radians."""
    height = source.elevation_deg
    return math.radians(source.azimuth_deg), None if height is None else math.radians(height)


def clock(seconds: float) -> str:
    """Seconds as ``0:03.5``, from an hour on as ``1:02:03.5``."""
    tenths = round(seconds * 10)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    short = f"{minutes:02d}" if hours else f"{minutes}"
    return f"{f'{hours}:' if hours else ''}{short}:{rest / 10:04.1f}"


def columns(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> str:
    """Rows, headed by the first, as aligned columns; those in ``right`` to the right."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = (
        "  ".join(
            text.rjust(width) if index in right else text.ljust(width)
            for index, (text, width) in enumerate(zip(row, widths))
        )
        for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)
