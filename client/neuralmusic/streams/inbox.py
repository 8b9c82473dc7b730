"""Unread events: a bounded queue that keeps the newest results."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import Union

from neuralmusic.protocol.server_messages import RESULTS, AnyServerMessage
from neuralmusic.timeout import within


@dataclass(frozen=True)
class Reconnecting:
    """The connection is lost; audio is dropped until the ``Ready`` of a new session."""

    reason: str
    """Reason why the connection ended or the last attempt failed"""
    attempt: int
    """Failed attempts since the connection was lost, from 0"""
    delay_s: float
    """Seconds until the next attempt"""


@dataclass(frozen=True)
class NewSession:
    """Another session follows a lost one, told after its ``Ready``; numbers, time and ids go on."""

    session: str
    """Id of the new session"""
    previous: str
    """Id of the session before"""
    t_start: float
    """Seconds of stream time at which it begins; audio of the outage is missing before"""
    outage_s: float
    """Seconds since the last result of the session before"""


StreamEvent = Union[AnyServerMessage, Reconnecting, NewSession]


class Inbox:
    """Events of all sessions in order, filled on the event loop, taken by any thread.

    Parameters
    ----------
    capacity : int
        Most events in the queue. Beyond it the oldest result is dropped, or another event where no
        result waits.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._lock = threading.Lock()
        self._events: deque[StreamEvent] = deque()
        self._error: BaseException | None = None
        self._ended = False
        self.results_dropped = 0

    @cached_property
    def _changed(self) -> asyncio.Event:
        """An event, made on the loop: before Python 3.10 it belongs to the loop it is made on."""
        return asyncio.Event()

    @property
    def ended(self) -> bool:
        """True once the queue is empty and nothing will come."""
        return self._ended and not self._events

    def put(self, event: StreamEvent) -> None:
        """Append an event."""
        with self._lock:
            if len(self._events) >= self._capacity:
                self._drop()
            self._events.append(event)
        self._changed.set()

    def end(self, error: BaseException | None) -> None:
        """End the queue; readers get the error after the last event."""
        self._ended, self._error = True, error
        self._changed.set()

    def take(self) -> StreamEvent | None:
        """The oldest event, or None.

        Raises
        ------
        DoaError
            If the queue is empty and the stream ended with an error.
        """
        with self._lock:
            if self._events:
                return self._events.popleft()
        if self._ended and self._error is not None:
            raise self._error
        return None

    async def wait(self, timeout_s: float | None = None) -> None:
        """Wait until ``take`` has an event, or nothing will come.

        Waiting takes no event, so a cancelled wait loses none.
        """
        with contextlib.suppress(asyncio.TimeoutError):
            await within(timeout_s, self._arrival())

    async def _arrival(self) -> None:
        while not (self._events or self._ended):
            self._changed.clear()
            await self._changed.wait()

    def _drop(self) -> None:
        for index, event in enumerate(self._events):
            if isinstance(event, RESULTS):
                del self._events[index]
                self.results_dropped += 1
                return
        self._events.popleft()
