"""What both stream clients offer without waiting: what is known, and messages to the service."""

from __future__ import annotations

from typing import Any

from service.client.addresses import stream_url
from service.client.backoff import Backoff
from service.client.connection import Timeouts
from service.client.inbox import StreamEvent
from service.client.sessions import Sessions, StreamOptions
from service.client.start import read_start
from service.protocol.client_messages import (
    Calibrate,
    Flush,
    OutputUpdate,
    Ping,
    Start,
    Update,
)
from service.protocol.server_messages import Ready, Result, Summary


class StreamControls:
    """A stream that reconnects, but for opening, sending, receiving and closing."""

    def __init__(
        self,
        url: str,
        start: Start | None = None,
        *,
        key: str | None = None,
        reconnect: bool | None = None,
        wait_s: float = 0.0,
        queue_s: float = 0.5,
        max_unread: int | None = None,
        backoff: Backoff | None = None,
        timeouts: Timeouts | None = None,
        **fields: Any,
    ) -> None:
        """Prepare a stream; nothing is connected yet.

        Parameters
        ----------
        url : str
            ``http(s)://`` or ``ws(s)://``, with or without ``/stream``.
        start : Start, optional
            The first message; or give its fields (``audio``, ``array``, ``output``, ...) by name.
        key : str, optional
            The service's key.
        reconnect : bool, optional
            Whether a lost session is followed by another; by default where ``overflow`` is
            ``drop_oldest``, since of a recording nothing may be missing.
        wait_s : float
            Seconds to keep trying the first connection, for a robot that starts before its service.
        queue_s : float
            Seconds of audio that wait at most while the network or the service is slow. Then the
            oldest is dropped (``dropped_s``), or ``send`` waits where ``overflow`` is ``block``.
        max_unread : int, optional
            Events that wait to be read at most; the oldest results go first (``results_dropped``).
        backoff, timeouts
            How long to wait between attempts, and for a silent service.
        **fields
            Fields of ``Start``; ``array`` may be a preset's name alone.

        Raises
        ------
        InvalidMessage, InvalidOption
            If a field or the address is wrong.
        """
        options = StreamOptions(
            key, reconnect, wait_s, queue_s, max_unread, backoff or Backoff(), timeouts
        )
        self._sessions = Sessions(stream_url(url), read_start(start, fields), options)

    @property
    def ready(self) -> Ready:
        """What is in effect; another one, with another session, after a reconnection."""
        return self._sessions.ready

    @property
    def latest(self) -> Result | None:
        """The newest result, read or not."""
        return self._sessions.latest

    @property
    def summary(self) -> Summary | None:
        """The session as a whole, once it has ended in order."""
        return self._sessions.summary

    @property
    def live(self) -> bool:
        """True where stale audio is dropped (``overflow: "drop_oldest"``)."""
        return self._sessions.live

    @property
    def connected(self) -> bool:
        """True while a session runs."""
        return self._sessions.outgoing.connected

    @property
    def ended(self) -> bool:
        """True where everything was read and nothing will come."""
        return self._sessions.inbox.ended

    @property
    def dropped_s(self) -> float:
        """Seconds of audio that were dropped before they were sent."""
        return self._sessions.outgoing.dropped_s

    @property
    def results_dropped(self) -> int:
        """Results that were dropped since nobody read them."""
        return self._sessions.inbox.results_dropped

    def update(self, **changes: Any) -> None:
        """Change output options from the next result on, and for later sessions.

        Parameters
        ----------
        **changes
            Fields of ``OutputOptions``: ``interval_ms``, ``yaw_deg``, ``exclude_deg``, ...

        Raises
        ------
        InvalidMessage
            If a field is unknown or out of range.
        """
        self._sessions.check_running()
        current = self._sessions.start.model_dump(mode="json", exclude_unset=True)
        current["output"] = {**current.get("output", {}), **changes}
        del current["type"]
        start = read_start(None, current)
        fields = {name: getattr(start.output, name) for name in changes}
        self._sessions.start = start  # before it is sent: a session may be lost at any time
        self._sessions.control(Update(type="update", output=OutputUpdate.model_construct(**fields)))

    def flush(self) -> None:
        """Localize what was sent so far now; ``Flushed`` follows the last of these results."""
        self._sessions.control(Flush(type="flush"))

    def ping(self, id: int | None = None) -> None:
        """Ask for a ``Pong`` with this number."""
        self._sessions.control(Ping(type="ping", id=id))

    def calibrate(self, seconds: float = 5.0) -> None:
        """Learn the robot's noise from the audio that follows; ``Calibrated`` tells the end."""
        self._sessions.control(Calibrate(type="calibrate", kind="noise", seconds=float(seconds)))

    def take(self) -> StreamEvent | None:
        """``receive`` without waiting, from any thread."""
        return self._sessions.inbox.take()

    def received(self) -> list[StreamEvent]:
        """Everything that has come and was not read, without waiting."""
        self._sessions.check_open()
        events: list[StreamEvent] = []
        while (event := self.take()) is not None:
            events.append(event)
        return events
