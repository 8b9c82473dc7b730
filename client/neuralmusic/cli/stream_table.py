"""The table of ``neuralmusic stream``: the sources and their directions, live."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from neuralmusic.cli.stream_outputs import heading, note
from neuralmusic.cli.terminal import table
from neuralmusic.cli.words import clock, direction, radians, sector
from neuralmusic.protocol.server_messages import ODAS_HOP_S, OdasSst, Ready, Result, Summary
from neuralmusic.streams.inbox import StreamEvent

MAX_NOTES = 6
LIKELY_ACTIVE = 0.5


@dataclass(frozen=True)
class Row:
    """One source of the newest result."""

    id: int
    azimuth: float
    """Radians, counter-clockwise"""
    elevation: Optional[float]
    """Radians, if the array tells it"""
    confidence: float
    active: bool


class LiveTable:
    """A table redrawn with every result, with warnings below, each kind once.

    Parameters
    ----------
    console : rich.console.Console
        Where it cannot redraw, only the last state is printed.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._heading = "connecting"
        self._status = ""
        self._rows: list[Row] = []
        self._notes: dict[str, tuple[str, int]] = {}
        """Newest note of every kind and its count, by how it begins"""
        self._live = Live(self._drawn(), console=console, auto_refresh=False)
        self._live.start()

    def show(self, event: StreamEvent) -> None:
        if isinstance(event, Ready):
            self._heading = heading(event)
        elif isinstance(event, Result):
            self._rows = [Row(s.id, *radians(s), s.confidence, s.active) for s in event.sources]
            why = f", {event.why_no_source.replace('_', ' ')}" if event.why_no_source else ""
            self._status = f"{clock(event.t_end)}, {event.lag_ms:.0f} ms behind{why}"
        elif isinstance(event, OdasSst):
            self._rows = [
                Row(s.id, math.atan2(s.y, s.x), None, s.activity, s.activity > LIKELY_ACTIVE)
                for s in event.src
                if s.id
            ]
            self._status = clock(event.timeStamp * ODAS_HOP_S)
        else:
            self._note(event)
        self._live.update(self._drawn(), refresh=True)

    def say(self, words: str) -> None:
        """Add a line below the table."""
        kind = words.split(":")[0] if not words.startswith("warning: ") else words.split(":")[1]
        _, count = self._notes.pop(kind, ("", 0))
        self._notes[kind] = (words, count + 1)
        while len(self._notes) > MAX_NOTES:
            self._notes.pop(next(iter(self._notes)))

    def close(self) -> None:
        self._live.stop()
        if not self._console.is_terminal:
            self._console.print()  # the last state ends without a newline

    def _note(self, event: StreamEvent) -> None:
        words = note(event)
        if words and not isinstance(event, Summary):  # the summary is printed at the end
            self.say(words)

    def _drawn(self) -> Group:
        columns = ("id", "direction", "confidence")
        drawn = table(self._console, "id", "direction", "", "confidence", "", right=columns)
        for row in self._rows:
            drawn.add_row(
                str(row.id),
                direction(row.azimuth, row.elevation),
                sector(row.azimuth),
                f"{row.confidence:.2f}",
                "active" if row.active else "pausing",
                style=None if row.active else "dim",
            )
        lines = [
            Text(words if count == 1 else f"{words} ({count}x)", style="yellow")
            for words, count in self._notes.values()
        ]
        return Group(Text(self._heading, style="bold"), Text(self._status), drawn, *lines)
