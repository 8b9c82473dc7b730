"""The room of the temporary folder, shared by the uploads that are under way."""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from neuralmusic.errors import RequestTimeout

LEAST_BYTES_PER_S = 256 * 2**10
"""Rate below which an upload is ended where another one needs its room; while there is room, the
slowest robot may take its time"""
AVERAGED_S = 10.0
"""Seconds over which the rate is averaged: what came fast before does not count for long"""
MARGIN_BYTES = 2**20
"""Bytes kept free for what other uploads write at the same moment"""


def free_bytes() -> int:
    """Bytes that can still be written to the temporary folder."""
    found = os.statvfs(tempfile.gettempdir())
    return found.f_bavail * found.f_frsize


class Arrival:
    """One upload under way; its own task alone enters and leaves it."""

    def __init__(self, spool: Spool, now: float) -> None:
        self._spool = spool
        self.due = now + AVERAGED_S
        """Time at which the upload is too slow if nothing more comes"""
        self.held = 0
        """Bytes received"""
        self.deadline = asyncio.timeout(None)
        self.gone = asyncio.Event()
        """Set once its file is closed"""

    def received(self, size: int) -> None:
        """Count bytes of the body."""
        now = asyncio.get_running_loop().time()
        self.held += size
        self.due = min(now + AVERAGED_S, self.due + size / LEAST_BYTES_PER_S)

    async def make_room(self, size: int) -> None:
        """End uploads that are too slow while there is no room for ``size`` more bytes."""
        await self._spool.make_room(size, self)

    def end(self) -> None:
        """Let the upload fail with RequestTimeout."""
        if not self.deadline.expired():
            self.deadline.reschedule(asyncio.get_running_loop().time())


class Spool:
    """The uploads under way of one service; used on the event loop alone.

    Parameters
    ----------
    free : callable
        Gives the bytes that are free.
    """

    def __init__(self, free: Callable[[], int] = free_bytes) -> None:
        self._free = free
        self._arriving: set[Arrival] = set()

    @asynccontextmanager
    async def arriving(self) -> AsyncIterator[Arrival]:
        """Count an upload while its body arrives and is written.

        Raises
        ------
        RequestTimeout
            If it was too slow when another upload needed its room.
        """
        arrival = Arrival(self, asyncio.get_running_loop().time())
        self._arriving.add(arrival)
        try:
            async with arrival.deadline:
                yield arrival
        except TimeoutError:
            if not arrival.deadline.expired():
                raise
            raise RequestTimeout(
                f"the body came at less than {LEAST_BYTES_PER_S // 2**10} kB a second while there "
                "was no room for other uploads: send it again over a better connection, or send "
                "FLAC"
            ) from None
        finally:
            self._arriving.discard(arrival)
            arrival.gone.set()

    async def make_room(self, size: int, asking: Arrival) -> None:
        """End other uploads that are too slow, the largest first, until ``size`` bytes fit.

        Where none is too slow, nothing happens: the write itself then fails.
        """
        while self._free() < size + MARGIN_BYTES:
            now = asyncio.get_running_loop().time()
            slow = [each for each in self._arriving if each.due < now and each is not asking]
            if not slow:
                return
            largest = max(slow, key=lambda each: each.held)
            largest.end()
            await largest.gone.wait()
