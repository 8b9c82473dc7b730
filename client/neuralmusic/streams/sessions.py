"""Successive sessions for both stream clients: send, receive, reconnect."""

from __future__ import annotations

import asyncio
import contextlib
import math
from dataclasses import dataclass, field
from typing import Any, Union

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from neuralmusic.client_errors import (
    ServiceProblem,
    ServiceUnreachable,
    StreamClosed,
    StreamRefused,
)
from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.client_messages import Ping, Start, Stop
from neuralmusic.protocol.message import Message
from neuralmusic.protocol.server_messages import (
    RESULTS,
    Closing,
    Ready,
    Result,
    StreamError,
    Summary,
)
from neuralmusic.streams.backoff import Backoff
from neuralmusic.streams.connection import Timeouts, close_at_once, closed_by, open_connection
from neuralmusic.streams.continuity import Continuity
from neuralmusic.streams.inbox import Inbox, Reconnecting
from neuralmusic.streams.incoming import Incoming
from neuralmusic.streams.send_queue import SendQueue
from neuralmusic.timeout import within

NOT_OPEN = "the stream is not open yet: use it as a context manager"
OPEN_ALREADY = "the stream is open already, or was: make another one"
UNREAD_LIVE = 64
UNREAD_RECORDING = 10_000
RECORDING_PING_TIMEOUT_S = 120.0
"""Ping timeout in seconds for recordings: a service at full speed reads pings late"""

Failure = Union[ServiceProblem, ServiceUnreachable]


@dataclass(frozen=True)
class StreamOptions:
    """Options of a stream, as ``StreamControls`` explains them."""

    key: str | None = field(default=None, repr=False)
    reconnect: bool | None = None
    wait_s: float = 0.0
    queue_s: float = 0.5
    max_unread: int | None = None
    backoff: Backoff = field(default_factory=Backoff)
    timeouts: Timeouts | None = None


class Sessions:
    """The connections of one stream, at most one at a time.

    Parameters
    ----------
    url : str
        ``ws://`` or ``wss://``.
    start : Start
        The first message of every session; ``update`` replaces it.
    """

    _added: asyncio.Event
    """Event set when a message waits; ``open`` makes it on the event loop, since before Python 3.10
    an event belongs to the loop it is made on"""
    _taken: asyncio.Event
    """Event set when a message was sent or a session ended"""

    def __init__(self, url: str, start: Start, options: StreamOptions) -> None:
        self.url = url
        self.start = start
        self.live = start.overflow == "drop_oldest"
        self._options = options
        self._reconnect = self.live if options.reconnect is None else options.reconnect
        self._timeouts = options.timeouts or Timeouts(
            ping_timeout_s=Timeouts().ping_timeout_s if self.live else RECORDING_PING_TIMEOUT_S
        )
        self.outgoing = SendQueue(start.audio, options.queue_s, drop=self.live, wake=self._wake)
        self.inbox = Inbox(options.max_unread or (UNREAD_LIVE if self.live else UNREAD_RECORDING))
        self._continuity = Continuity(self.live)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._ready: Ready | None = None
        self.latest: Result | None = None
        self.summary: Summary | None = None
        self._error: Exception | None = None
        """Error that ended the last session, if any"""
        self._received = 0
        """Number of messages received so far"""
        self._stopping = False
        self._failures = 0

    @property
    def ready(self) -> Ready:
        """The ``ready`` of the last session; InvalidOption before the first."""
        if self._ready is None:
            raise InvalidOption(NOT_OPEN)
        return self._ready

    async def open(self) -> None:
        """Begin the first session, within ``wait_s``; others follow until ``close`` or ``stop``."""
        if self._task is not None:
            raise InvalidOption(OPEN_ALREADY)
        self._loop = asyncio.get_running_loop()
        self._added, self._taken = asyncio.Event(), asyncio.Event()
        try:
            websocket = await self._connect(None, self._loop.time() + self._options.wait_s)
        finally:
            self._failures = 0
        self._task = asyncio.create_task(self._run(websocket))

    async def close(self) -> None:
        """End at once; a second call does nothing."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    def check_open(self) -> asyncio.Task[None]:
        """Raise InvalidOption before ``open``."""
        if self._task is None:
            raise InvalidOption(NOT_OPEN)
        return self._task

    def check_running(self) -> None:
        """Raise the error that ended the stream, where it has ended."""
        if self.check_open().done():
            raise self._error or StreamClosed(
                "stopped", "Stream stopped", "the stream has ended: open another for more audio"
            )

    def post(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Queue audio, from any thread."""
        self.check_running()
        self.outgoing.add_audio(audio, capture_time_ns)

    async def send(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Queue audio once there is room, or at once where stale audio is dropped."""
        while not self.live and not self.outgoing.has_room and self.outgoing.connected:
            self._taken.clear()
            await self._taken.wait()
        self.post(audio, capture_time_ns)

    def control(self, message: Message) -> None:
        """Queue a control message, from any thread."""
        self.check_running()
        self.outgoing.add_text(message.model_dump_json(exclude_unset=True))

    @property
    def began_s(self) -> float:
        """Seconds of the stream at which the session in progress began; 0 for the first one."""
        return self._continuity.offset_s

    async def stop(self, timeout_s: float) -> Summary:
        """Send waiting audio, end the session and wait for its summary."""
        self.check_running()
        self._stopping = True
        if not self.outgoing.connected:
            await self.close()  # between two sessions there is nothing to sum up
        else:
            self.outgoing.add_text(Stop(type="stop").model_dump_json(), last=True)
            await self._wait_for_end(timeout_s)
        if self.summary is None:
            raise self._error or StreamClosed(
                "connection_lost", "Connection lost", "the stream ended without a summary"
            )
        return self.summary

    async def _wait_for_end(self, timeout_s: float) -> None:
        task = self.check_open()
        while not task.done():
            before = self._received
            await asyncio.wait([task], timeout=timeout_s)
            if not task.done() and self._received == before:
                await self.close()
                raise ServiceUnreachable(f"{self.url} did not answer `stop` within {timeout_s:g} s")

    async def _run(self, websocket: ClientConnection) -> None:
        """Run sessions until one ends for good; ``_error`` holds the error, if any."""
        try:
            while True:
                closed = await self._session(websocket)
                if closed is None or self._stopping or not (self._reconnect and closed.retryable):
                    self._error = closed
                    return
                websocket = await self._connect(closed, math.inf)
        except Exception as error:
            self._error = error  # the reader gets it
        finally:
            self.inbox.end(self._error)

    def _wake(self) -> None:
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._added.set)

    async def _connect(self, error: Failure | None, deadline: float) -> ClientConnection:
        """Begin a session; try until the service accepts it, refuses for good, or time is up.

        Parameters
        ----------
        error : Failure or None
            Why the last session or attempt failed; None for the first attempt, which does not wait.
        deadline : float
            Loop time after which no attempt begins.
        """
        audio, options = self.start.audio, self._options
        held_back = int(options.queue_s * audio.sample_rate) * audio.frame_bytes
        while True:
            if error is not None:
                await self._wait_after(error, deadline)
            try:
                websocket, ready = await open_connection(
                    self.url, self.start, options.key, self._timeouts, held_back
                )
            except (ServiceUnreachable, StreamRefused) as refused:
                error = refused
                continue
            self._ready, begun = self._continuity.begin(ready, asyncio.get_running_loop().time())
            self.summary = None
            self.outgoing.begin()
            self.inbox.put(self._ready)
            if begun is not None:
                self.inbox.put(begun)
            return websocket

    async def _wait_after(self, error: Failure, deadline: float) -> None:
        """Wait for the next attempt; raise the error where there is no next one."""
        delay_s = self._options.backoff.delay_s(self._failures, error.retry_after_s)
        if not error.retryable or asyncio.get_running_loop().time() + delay_s > deadline:
            raise error
        if self._ready is not None:
            self.inbox.put(Reconnecting(error.detail, self._failures, delay_s))
        self._failures += 1
        await asyncio.sleep(delay_s)

    async def _session(self, websocket: ClientConnection) -> StreamClosed | None:
        """Send and receive until the connection ends; None where it ended without an error."""
        sender = asyncio.create_task(self._send_all(websocket))
        try:
            said = await self._read_all(websocket)
        finally:
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)
            self.outgoing.end()
            self._taken.set()
            await close_at_once(websocket)
        if websocket.close_code == 1000 and not isinstance(said, StreamError):
            return None
        return closed_by(websocket, said, StreamClosed)

    async def _send_all(self, websocket: ClientConnection) -> None:
        try:
            while True:
                self._added.clear()
                while (message := self.outgoing.take()) is not None:
                    self._taken.set()
                    await within(self._timeouts.ping_timeout_s, websocket.send(message))
                await self._wait_for_audio(websocket)
        except ConnectionClosed:
            pass
        except asyncio.TimeoutError:
            # Pings queue behind data that the network does not take, so none is ever missed.
            websocket.transport.abort()

    async def _wait_for_audio(self, websocket: ClientConnection) -> None:
        """Wait until a message is there to be sent; pings keep the session through a pause."""
        while not self._added.is_set():
            try:
                await within(self.ready.limits.idle_timeout_s / 3, self._added.wait())
            except asyncio.TimeoutError:
                ping = Ping(type="ping").model_dump_json(exclude_unset=True)
                await within(self._timeouts.ping_timeout_s, websocket.send(ping))

    async def _read_all(self, websocket: ClientConnection) -> StreamError | Closing | None:
        """Read until the connection is closed; return the service's ``error`` or ``closing``."""
        said: StreamError | Closing | None = None
        incoming, clock = Incoming(), asyncio.get_running_loop().time
        with contextlib.suppress(ConnectionClosed):
            while True:
                read = incoming.read(await websocket.recv())
                if read is None:
                    continue
                message = self._continuity.follow(read, clock())
                self._received += 1
                if isinstance(message, RESULTS):
                    self._failures = 0  # connected again: the next outage begins with short delays
                if isinstance(message, Result):
                    self.latest = message
                elif isinstance(message, Summary):
                    self.summary = message
                elif isinstance(message, (StreamError, Closing)):
                    said = message
                self.inbox.put(message)
        return said
