"""Lines that ``neuralmusic stream`` prints for people where rich is not installed."""

from __future__ import annotations

from typing import TextIO

from neuralmusic.cli.stream_outputs import Text, heading, note
from neuralmusic.cli.words import clock, direction, radians, sector
from neuralmusic.protocol.server_messages import Ready, Result, Summary
from neuralmusic.streams.inbox import StreamEvent


class PlainLines(Text):
    """A line whenever a source moves, falls silent or starts to speak."""

    def __init__(self, file: TextIO) -> None:
        super().__init__(file)
        self._last = ""

    def text(self, event: StreamEvent) -> str:
        if isinstance(event, Ready):
            return f"{heading(event)}\n"
        if not isinstance(event, Result):
            words = "" if isinstance(event, Summary) else note(event)  # printed at the end
            return f"{words}\n" if words else ""
        heard = ", ".join(
            f"{direction(*towards)} {sector(towards[0])} (id {source.id})"
            for source in event.sources
            if source.active
            for towards in [radians(source)]
        )
        if heard == self._last:
            return ""
        self._last = heard
        return f"{clock(event.t_end)} {heard or '-'}\n"
