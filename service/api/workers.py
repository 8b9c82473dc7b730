"""Worker threads for recordings: a bounded number works, a bounded number waits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import anyio
import anyio.from_thread
import anyio.to_thread
from starlette.requests import ClientDisconnect, Request

from service.errors import Draining, Overloaded

T = TypeVar("T")
Progress = Callable[[float], None]


class WorkerPool:
    """At most ``workers`` calls at a time and ``queue`` waiting ones; more are refused."""

    def __init__(self, workers: int, queue: int) -> None:
        self._limiter = anyio.CapacityLimiter(workers)
        self._capacity = workers + queue
        self._admitted = 0
        self._stopping = False

    @property
    def admitted(self) -> int:
        """Recordings in work or waiting."""
        return self._admitted

    @property
    def count(self) -> int:
        """Workers that there are."""
        return int(self._limiter.total_tokens)

    def check(self) -> None:
        """Raise Draining or Overloaded where one more call would be refused."""
        self._check_stopping()
        if self._admitted >= self._capacity:
            raise Overloaded(
                f"{self._admitted} recordings are being localized or wait for it: try again later"
            )

    async def run(self, request: Request, work: Callable[[Progress], T]) -> T:
        """Call ``work`` in a thread, once a worker is free.

        ``work`` gets a progress callback, which ends it once nobody waits for it any more: a robot
        that times out and retries would otherwise pile up work.
        """

        def progress(share: float) -> None:
            self._check_stopping()
            if anyio.from_thread.run(request.is_disconnected):
                raise ClientDisconnect

        self.check()
        self._admitted += 1
        try:
            return await anyio.to_thread.run_sync(work, progress, limiter=self._limiter)
        finally:
            self._admitted -= 1

    def stop(self) -> None:
        """End running calls at their next progress, and refuse new ones."""
        self._stopping = True

    def _check_stopping(self) -> None:
        if self._stopping:
            raise Draining("the service is shutting down: try again in a moment")
