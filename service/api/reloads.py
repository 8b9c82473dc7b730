"""Reading anew what a service runs with: one at a time, never for ever."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Reloads(Generic[T]):
    """Whoever asks while one runs gets the next: that saw what was changed before it was asked for.

    Parameters
    ----------
    reload : callable
        Ends within a deadline of its own.
    """

    def __init__(self, reload: Callable[[], Awaitable[T]]) -> None:
        self._reload = reload
        self._running: asyncio.Task[T] | None = None
        self._next: asyncio.Task[T] | None = None

    async def ask(self) -> T:
        """What a reload gives that begins from now on, or its error; at most two are awaited."""
        if self._next is None:
            self._next = asyncio.create_task(self._after(self._running))
        # Who asked may go; others wait for the same one.
        return await asyncio.shield(self._next)

    async def _after(self, running: asyncio.Task[T] | None) -> T:
        if running is not None:
            await asyncio.wait({running})
        self._running, self._next = self._next, None
        return await self._reload()


async def within(seconds: float, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """What a function gives in a thread of its own, or TimeoutError.

    One that hangs, as on a network's file system, is left behind: neither the next one nor the
    process's end waits for it.
    """
    outcome: Future[T] = Future()
    outcome.set_running_or_notify_cancel()

    def run() -> None:
        try:
            outcome.set_result(function(*args, **kwargs))
        except BaseException as error:
            outcome.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    async with asyncio.timeout(seconds):
        return await asyncio.wrap_future(outcome)
