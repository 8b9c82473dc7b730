"""Sessions one after the other, for ``AsyncStreamClient``: send, receive, connect again."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, field

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from service.client.backoff import Backoff
from service.client.connection import Timeouts, closed_by, open_connection, read_known
from service.client.errors import ServiceProblem, ServiceUnreachable, StreamClosed, StreamRefused
from service.client.inbox import RESULTS, Inbox, Reconnecting
from service.client.send_queue import SendQueue
from service.protocol.client_messages import Start
from service.protocol.server_messages import Closing, Ready, Result, StreamError, Summary

UNREAD_LIVE = 64
UNREAD_FILE = 10_000
FILE_PING_TIMEOUT_S = 120.0
"""A service that takes a file as fast as it can reads pings late"""
CLOSE_S = 0.5
"""For the service's answer to a close"""

Opened = tuple[ClientConnection, Ready]
Failure = ServiceProblem | ServiceUnreachable


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """How a stream behaves; ``AsyncStreamClient`` tells what they mean."""

    key: str | None = field(default=None, repr=False)
    reconnect: bool | None = None
    wait_s: float = 0.0
    queue_s: float = 0.5
    max_unread: int | None = None
    backoff: Backoff = field(default_factory=Backoff)
    timeouts: Timeouts | None = None


class Sessions:
    """The connections of one stream, of which at most one is open.

    Parameters
    ----------
    url : str
        ``ws://`` or ``wss://``.
    start : Start
        Sent first in every session; ``update`` replaces it.
    """

    def __init__(self, url: str, start: Start, options: StreamOptions) -> None:
        self.url = url
        self.start = start
        self.live = start.overflow == "drop_oldest"
        self._options = options
        self._reconnect = self.live if options.reconnect is None else options.reconnect
        self._timeouts = options.timeouts or Timeouts(
            ping_timeout_s=Timeouts().ping_timeout_s if self.live else FILE_PING_TIMEOUT_S
        )
        self.outgoing = SendQueue(start.audio, options.queue_s, drop=self.live, wake=self._wake)
        self.inbox = Inbox(options.max_unread or (UNREAD_LIVE if self.live else UNREAD_FILE))
        self._loop: asyncio.AbstractEventLoop | None = None
        self._added = asyncio.Event()
        self.taken = asyncio.Event()
        """Something was sent, or a session ended"""
        self.ready: Ready | None = None
        self.latest: Result | None = None
        self.summary: Summary | None = None
        self.error: Exception | None = None
        """Why the last session ended, where that was not in order"""
        self.received = 0
        """Messages of the service so far"""
        self.stopping = False
        self._failures = 0

    async def first(self) -> Opened:
        """The first connection, within ``wait_s``."""
        self._loop = asyncio.get_running_loop()
        deadline = self._loop.time() + self._options.wait_s
        attempt = 0
        while True:
            try:
                opened = await self._connect()
                self._begin(opened[1])
                return opened
            except (ServiceUnreachable, StreamRefused) as error:
                delay = self._delay_s(attempt, error)
                if not error.retryable or self._loop.time() + delay > deadline:
                    raise
            attempt += 1
            await asyncio.sleep(delay)

    async def run(self, opened: Opened) -> None:
        """Sessions until one ends for good; ``error`` says why, unless it ended in order."""
        try:
            while True:
                closed = await self._session(opened[0])
                if closed is None or self.stopping or not (self._reconnect and closed.retryable):
                    self.error = closed
                    return
                opened = await self._reopen(closed)
                self._begin(opened[1])
        except Exception as error:
            self.error = error  # whoever reads gets it
        finally:
            self.inbox.end(self.error)

    def _wake(self) -> None:
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._added.set)

    async def _connect(self) -> Opened:
        audio = self.start.audio
        held_back = int(self._options.queue_s * audio.sample_rate) * audio.frame_bytes
        return await open_connection(
            self.url, self.start, self._options.key, self._timeouts, held_back
        )

    def _begin(self, ready: Ready) -> None:
        self.ready, self.summary = ready, None
        self.outgoing.begin()
        self.inbox.put(ready)

    async def _session(self, websocket: ClientConnection) -> StreamClosed | None:
        """Send and receive until the connection ends; None where that was in order."""
        sender = asyncio.create_task(self._send_all(websocket))
        try:
            said = await self._read_all(websocket)
        finally:
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)
            self.outgoing.end()
            self.taken.set()
            await _close(websocket)
        if websocket.close_code == 1000 and not isinstance(said, StreamError):
            return None
        return closed_by(websocket, said)

    async def _send_all(self, websocket: ClientConnection) -> None:
        try:
            while True:
                self._added.clear()
                while (message := self.outgoing.take()) is not None:
                    self.taken.set()
                    async with asyncio.timeout(self._timeouts.ping_timeout_s):
                        await websocket.send(message)
                await self._added.wait()
        except ConnectionClosed:
            pass
        except TimeoutError:
            # Pings wait behind what the network does not take, so that none is ever missed.
            websocket.transport.abort()

    async def _read_all(self, websocket: ClientConnection) -> StreamError | Closing | None:
        """Read until the connection is closed; gives the service's last word."""
        said: StreamError | Closing | None = None
        with contextlib.suppress(ConnectionClosed):
            while True:
                message = read_known(await websocket.recv())
                if message is None:
                    continue
                self.received += 1
                if isinstance(message, RESULTS):
                    self._failures = 0  # it works again: the next outage begins with short delays
                if isinstance(message, Result):
                    self.latest = message
                elif isinstance(message, Summary):
                    self.summary = message
                elif isinstance(message, StreamError | Closing):
                    said = message
                self.inbox.put(message)
        return said

    async def _reopen(self, cause: Failure) -> Opened:
        """Try until the service takes the session again, or says no for good."""
        error = cause
        while True:
            delay = self._delay_s(self._failures, error)
            self.inbox.put(Reconnecting(error.detail, self._failures, delay))
            self._failures += 1
            await asyncio.sleep(delay)
            try:
                return await self._connect()
            except (ServiceUnreachable, StreamRefused) as refused:
                if not refused.retryable:
                    raise
                error = refused

    def _delay_s(self, attempt: int, error: Failure) -> float:
        asked = error.retry_after_s if isinstance(error, ServiceProblem) else None
        return self._options.backoff.delay_s(attempt, asked)


async def _close(websocket: ClientConnection) -> None:
    """Close a connection; results that still come are not waited for."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(CLOSE_S):
            await websocket.close()
    websocket.transport.abort()
