"""Worker threads for recordings: a bounded number works, a bounded number waits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import anyio
import anyio.from_thread
import anyio.to_thread
from starlette.requests import ClientDisconnect, Request

from service.errors import Overloaded

T = TypeVar("T")


class WorkerPool:
    """At most ``workers`` calls at a time and ``queue`` waiting ones; more are refused."""

    def __init__(self, workers: int, queue: int) -> None:
        self._limiter = anyio.CapacityLimiter(workers)
        self._capacity = workers + queue
        self._admitted = 0

    def check(self) -> None:
        """Raise Overloaded where one more call would be refused."""
        if self._admitted >= self._capacity:
            raise Overloaded(
                f"{self._admitted} recordings are being localized or wait for it: try again later"
            )

    async def run(self, work: Callable[[], T]) -> T:
        """Call ``work`` in a thread, once a worker is free."""
        self.check()
        self._admitted += 1
        try:
            return await anyio.to_thread.run_sync(work, limiter=self._limiter)
        finally:
            self._admitted -= 1


def stop_when_gone(request: Request) -> Callable[[float], None]:
    """A progress callback for a worker thread that raises once the client has hung up.

    A robot that times out and retries would otherwise pile up work that nobody waits for.
    """

    def progress(share: float) -> None:
        if anyio.from_thread.run(request.is_disconnected):
            raise ClientDisconnect

    return progress
