"""Messages on their way to one client: a bounded queue where old results make room for new ones."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import NamedTuple

from neuralmusic.protocol.server_messages import Result, ServerMessage

MAX_DROPPABLE = 32
"""Most results queued for a client that reads slowly: three seconds at 10 Hz"""
MAX_WAITING = 1024
"""Most messages of any kind; a client that asks faster than it reads loses the oldest"""


class QueuedMessage(NamedTuple):
    """A message in the queue."""

    text: str
    droppable: bool
    arrived: float | None = None
    """Time at which the last audio of a result arrived, seconds"""


class Outbox:
    """A queue of texts between the session and the WebSocket's writer."""

    def __init__(self) -> None:
        self._waiting: deque[QueuedMessage] = deque()
        self._droppable = 0
        self._event = asyncio.Event()
        self._closed = False

    def put(self, text: str, *, droppable: bool, arrived: float | None = None) -> int:
        """Add a message; return how many old results were dropped for it."""
        self._waiting.append(QueuedMessage(text, droppable, arrived))
        self._droppable += droppable
        self._event.set()
        dropped = 0
        if self._droppable > MAX_DROPPABLE:
            self._remove_oldest()
            dropped = 1
        if len(self._waiting) > MAX_WAITING:
            self._droppable -= self._waiting.popleft().droppable
        return dropped

    def close(self) -> None:
        """Let ``get`` return None once the queue is empty."""
        self._closed = True
        self._event.set()

    async def get(self) -> QueuedMessage | None:
        """The next message; None once closed and empty."""
        while not self._waiting:
            if self._closed:
                return None
            self._event.clear()
            await self._event.wait()
        message = self._waiting.popleft()
        self._droppable -= message.droppable
        return message

    def _remove_oldest(self) -> None:
        for index, message in enumerate(self._waiting):
            if message.droppable:
                del self._waiting[index]
                self._droppable -= 1
                return


def message_json(message: ServerMessage, *, spectrum: bool = True) -> str:
    """A message as it is sent; what is unwanted or not there is absent from results, not null."""
    if not isinstance(message, Result):
        return message.model_dump_json()
    absent = {name for name in ("spectrum", "sphere", "pose") if getattr(message, name) is None}
    return message.model_dump_json(exclude=absent if spectrum else absent | {"spectrum"})
