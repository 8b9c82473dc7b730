"""A stream for asyncio: audio goes in, directions come out, and the connection looks after itself.

::

    async with AsyncStreamClient(
        "http://robot:8000",
        array="respeaker-usb-4mic-v2",
        audio={"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
    ) as stream:
        await stream.send(chunk)
        async for event in stream:
            ...
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from types import TracebackType
from typing import Any, Self

from service.client.addresses import stream_url
from service.client.backoff import Backoff
from service.client.connection import Timeouts, read_start
from service.client.errors import ServiceUnreachable, StreamClosed
from service.client.inbox import StreamEvent
from service.client.sessions import Sessions, StreamOptions
from service.errors import InvalidOption
from service.protocol.client_messages import (
    Calibrate,
    Flush,
    OutputUpdate,
    Ping,
    Start,
    Stop,
    Update,
)
from service.protocol.message import Message
from service.protocol.server_messages import Ready, Result, Summary

NOT_OPEN = "the stream is not open yet: use it as a context manager"


class AsyncStreamClient:
    """A stream that reconnects; iterating yields what the service says.

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
        ``drop_oldest``, since of a file nothing may be missing.
    wait_s : float
        Seconds to keep trying the first connection, for a robot that starts before its service.
    queue_s : float
        Seconds of audio that wait at most while the network or the service is slow. Then the oldest
        is dropped (``dropped_s``), or ``send`` waits where ``overflow`` is ``block``.
    max_unread : int, optional
        Events that wait to be read at most; the oldest results go first (``results_dropped``).
    backoff, timeouts
        How long to wait between attempts, and for a silent service.
    **fields
        Of ``Start``; ``array`` may be a preset's name alone.

    Raises
    ------
    InvalidMessage, InvalidOption
        If a field or the address is wrong.
    """

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
        options = StreamOptions(
            key, reconnect, wait_s, queue_s, max_unread, backoff or Backoff(), timeouts
        )
        self._sessions = Sessions(stream_url(url), read_start(start, fields), options)
        self._task: asyncio.Task[None] | None = None

    @property
    def ready(self) -> Ready:
        """What is in effect; another one, with another session, after a reconnection."""
        if self._sessions.ready is None:
            raise InvalidOption(NOT_OPEN)
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

    async def open(self) -> Self:
        """Connect and wait for ``ready``.

        Raises
        ------
        ServiceUnreachable
            If nothing answers, within ``wait_s`` where that is given.
        StreamRefused
            If the service says no.
        """
        if self._task is not None:
            raise InvalidOption("the stream is open already, or was: make another one")
        opened = await self._sessions.first()
        self._task = asyncio.create_task(self._sessions.run(opened))
        return self

    async def close(self) -> None:
        """End the connection at once, without the last results; again does nothing."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    async def send(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Send audio; never waits for the network, except where ``overflow`` is ``block``.

        Parameters
        ----------
        audio : bytes-like
            Interleaved samples as declared: bytes, or an array (T, N) of int16, int32 or float32.
        capture_time_ns : int, optional
            When the first sample frame was captured, for ``header: "seq_time"``; by default the
            last one was captured now.

        Raises
        ------
        AudioError, ChannelMismatch
            If the audio is not as declared.
        StreamClosed
            If the stream has ended.
        """
        waiting = self._sessions.outgoing
        while not self._sessions.live and not waiting.has_room and waiting.connected:
            self._sessions.taken.clear()
            await self._sessions.taken.wait()
        self.post(audio, capture_time_ns)
        await asyncio.sleep(0)  # a loop that only sends lets the connection work

    def post(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """``send`` without waiting for room, from any thread: for an audio device's callback."""
        self._check_running()
        self._sessions.outgoing.add_audio(audio, capture_time_ns)

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
        self._check_running()
        current = self._sessions.start.model_dump(mode="json", exclude_unset=True)
        current["output"] = {**current.get("output", {}), **changes}
        del current["type"]
        start = read_start(None, current)
        fields = {name: getattr(start.output, name) for name in changes}
        self._sessions.start = start  # before it is sent: a session may be lost at any time
        self._control(Update(type="update", output=OutputUpdate.model_construct(**fields)))

    def flush(self) -> None:
        """Localize what was sent so far now; ``Flushed`` follows the last of these results."""
        self._control(Flush(type="flush"))

    def ping(self, id: int | None = None) -> None:
        """Ask for a ``Pong`` with this number."""
        self._control(Ping(type="ping", id=id))

    def calibrate(self, seconds: float = 5.0) -> None:
        """Learn the robot's noise from the audio that follows; ``Calibrated`` tells the end."""
        self._control(Calibrate(type="calibrate", kind="noise", seconds=float(seconds)))

    async def stop(self, timeout_s: float = 30.0) -> Summary:
        """Send what waits, end the session and wait for its summary.

        The last results can still be read afterwards.

        Parameters
        ----------
        timeout_s : float
            Seconds without any message from the service after which it is given up.

        Raises
        ------
        StreamClosed, ServiceUnreachable
            If the session ended without a summary, or the service is silent.
        """
        self._check_running()
        self._sessions.stopping = True
        assert self._task is not None
        if not self.connected:
            await self.close()  # between two sessions there is nothing to sum up
        else:
            self._sessions.outgoing.add_text(Stop(type="stop").model_dump_json(), last=True)
            await self._wait_for_end(self._task, timeout_s)
        if self.summary is None:
            raise self._sessions.error or StreamClosed(
                "connection_lost", "Connection lost", "the stream ended without a summary"
            )
        return self.summary

    async def receive(self, timeout_s: float | None = None) -> StreamEvent | None:
        """The next event; None where none came in time, or the stream has ended (``ended``).

        Raises
        ------
        StreamClosed, StreamRefused, ServiceUnreachable
            After the last event, where the stream ended with an error.
        """
        await self.wait(timeout_s)
        return self._sessions.inbox.take()

    async def wait(self, timeout_s: float | None = None) -> None:
        """Wait until there is an event to receive, or the stream has ended."""
        await self._sessions.inbox.wait(timeout_s)

    def take(self) -> StreamEvent | None:
        """``receive`` without waiting, from any thread."""
        return self._sessions.inbox.take()

    def received(self) -> list[StreamEvent]:
        """Everything that has come and was not read, without waiting."""
        self._check_open()
        events: list[StreamEvent] = []
        while (event := self.take()) is not None:
            events.append(event)
        return events

    async def __aiter__(self) -> AsyncIterator[StreamEvent]:
        while (event := await self.receive()) is not None:
            yield event

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    def _check_open(self) -> asyncio.Task[None]:
        if self._task is None:
            raise InvalidOption(NOT_OPEN)
        return self._task

    def _check_running(self) -> None:
        if self._check_open().done():
            raise self._sessions.error or StreamClosed(
                "stopped", "Stream stopped", "the stream has ended: open another for more audio"
            )

    def _control(self, message: Message) -> None:
        self._check_running()
        self._sessions.outgoing.add_text(message.model_dump_json(exclude_unset=True))

    async def _wait_for_end(self, task: asyncio.Task[None], timeout_s: float) -> None:
        while not task.done():
            before = self._sessions.received
            await asyncio.wait([task], timeout=timeout_s)
            if not task.done() and self._sessions.received == before:
                await self.close()
                raise ServiceUnreachable(
                    f"{self._sessions.url} did not answer `stop` within {timeout_s:g} s"
                )
