"""Outputs of ``neuralmusic stream``: text, files, datagrams."""

from __future__ import annotations

import csv
import json
import socket
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Protocol, TextIO

from neuralmusic.cli.addresses import Address
from neuralmusic.cli.odas import odas_text
from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.server_messages import (
    RESULTS,
    Calibrated,
    Closing,
    OdasSsl,
    OdasSst,
    Ready,
    Result,
    StreamWarning,
    Summary,
)
from neuralmusic.streams.inbox import NewSession, Reconnecting, StreamEvent

COLUMNS = (
    "t_start", "t_end", "capture_time_ns", "id", "azimuth_deg", "elevation_deg", "confidence",
    "active", "velocity_deg_s", "std_deg", "lag_ms", "session",
)  # fmt: skip
MAX_DATAGRAM = 65_507


class Output(Protocol):
    """Shows the service's messages."""

    def show(self, event: StreamEvent) -> None: ...

    def close(self) -> None: ...


class Text:
    """Results as text, into a file or a pipe."""

    def __init__(self, file: TextIO, *, closing: bool = False) -> None:
        self._file = file
        self._closing = closing

    def show(self, event: StreamEvent) -> None:
        written = self.text(event)
        if written:
            self._file.write(written)
            self._file.flush()  # a robot reads line by line

    def text(self, event: StreamEvent) -> str:
        """The text for an event; empty where there is none."""
        raise NotImplementedError

    def close(self) -> None:
        if self._closing:
            self._file.close()


class JsonLines(Text):
    """One result or warning per line, and one where another session begins; ``type`` tells."""

    def text(self, event: StreamEvent) -> str:
        told = (*RESULTS, StreamWarning, NewSession)
        return f"{json_line(event)}\n" if isinstance(event, told) else ""


class OdasObjects(Text):
    """ODAS' objects of one kind as ODAS prints them."""

    def __init__(self, file: TextIO, kind: type[OdasSst | OdasSsl]) -> None:
        super().__init__(file)
        self._kind = kind

    def text(self, event: StreamEvent) -> str:
        return odas_text(event) if isinstance(event, self._kind) else ""


class CsvRows:
    """One row per source and result; silence has no rows."""

    def __init__(self, file: TextIO, *, closing: bool = False) -> None:
        self._file = file
        self._closing = closing
        self._writer = csv.writer(file, lineterminator="\n")
        self._writer.writerow(COLUMNS)

    def show(self, event: StreamEvent) -> None:
        if not isinstance(event, Result):
            return
        for source in event.sources:
            values = {**dict(event), **dict(source)}
            self._writer.writerow([_cell(values[name]) for name in COLUMNS])
        self._file.flush()

    def close(self) -> None:
        if self._closing:
            self._file.close()


def _cell(value: object) -> object:
    """The value as a cell; booleans are JSON's, as in the other outputs."""
    return str(value).lower() if isinstance(value, bool) else value


class Datagrams:
    """Every result's JSON as one UDP datagram; nobody needs to listen."""

    def __init__(self, address: Address) -> None:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        self._address = found[4]
        self._socket = socket.socket(found[0], socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def show(self, event: StreamEvent) -> None:
        if not isinstance(event, (*RESULTS, NewSession)):
            return
        if len(data := json_line(event).encode()) <= MAX_DATAGRAM:
            try:
                self._socket.sendto(data, self._address)
            except OSError:  # nobody listens, or no room: the next result is newer anyway
                return

    def close(self) -> None:
        self._socket.close()


class Notes:
    """Events other than results, in plain words, one per line."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def show(self, event: StreamEvent) -> None:
        words = note(event)
        if words:
            self._say(words)

    def close(self) -> None:
        return


class Outputs:
    """Several outputs at once, closed together."""

    def __init__(self) -> None:
        self._all: list[Output] = []
        self._closing = ExitStack()

    def add(self, output: Output) -> None:
        self._all.append(output)
        self._closing.callback(output.close)

    def show(self, event: StreamEvent) -> None:
        for output in self._all:
            output.show(event)

    def close(self) -> None:
        self._closing.close()


def saved(path: Path) -> Output:
    """A file of results, in the format of its ending."""
    kinds: dict[str, type[JsonLines | CsvRows]] = {".jsonl": JsonLines, ".csv": CsvRows}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise InvalidOption(f"--save {path}: end its name in .jsonl or .csv")
    return kind(path.open("w", encoding="utf-8", newline=""), closing=True)


def json_line(event: StreamEvent) -> str:
    """The JSON of a result, a warning or a new session on one line; null fields are left out."""
    if isinstance(event, NewSession):
        return json.dumps({"type": "new_session", **asdict(event)})
    assert isinstance(event, (*RESULTS, StreamWarning))
    return event.model_dump_json(exclude_none=True)


def note(event: StreamEvent) -> str | None:
    """A line for people about an event other than a result."""
    if isinstance(event, StreamWarning):
        return f"warning: {event.code}: {event.detail}"
    if isinstance(event, Reconnecting):
        return f"{event.reason}: next attempt in {event.delay_s:.1f} s"
    if isinstance(event, NewSession):
        return (
            f"session {event.session} follows {event.previous} after {event.outage_s:.1f} s; "
            "time and ids go on"
        )
    if isinstance(event, Calibrated):
        kept = f", kept as {event.name}" if event.name else ""
        return f"the noise of {event.seconds:.1f} s was learnt{kept}"
    if isinstance(event, Closing) and event.code != "done":
        return event.detail
    if isinstance(event, Summary):
        return summary_line(event)
    return None


def heading(ready: Ready) -> str:
    """Array, method and noise in effect, on one line."""
    by = f"{ready.model.name} {ready.model.version}" if ready.model else ready.method
    channels = ", ".join(map(str, ready.channel_map))
    noise = f", noise of {ready.noise.name}" if ready.noise else ""
    return f"{ready.array.name} (channels {channels}) by {by}{noise}, session {ready.session}"


def summary_line(summary: Summary) -> str:
    """A session in one line."""
    lost = summary.dropped_s + summary.gap_s
    parts = [
        f"{summary.audio_s:.1f} s of audio",
        f"{summary.results} result{'s' if summary.results != 1 else ''}",
        f"{len(summary.sources)} source{'s' if len(summary.sources) != 1 else ''}",
        *([f"{lost:.1f} s lost"] if lost else []),
        *(f"{code} {count}x" for code, count in summary.warnings.items()),
    ]
    return ", ".join(parts)
