"""An event loop in a thread of its own, for programs without asyncio."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from typing import Any, TypeVar

from neuralmusic.errors import InvalidOption

T = TypeVar("T")
END_S = 1.0
"""Seconds for other threads' calls to return when the loop ends"""


class LoopThread:
    """A running event loop; any thread may run coroutines on it."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._calls = threading.Lock()
        self.closed = False
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="neuralmusic-stream", daemon=True
        )
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine and return its result; an interrupted caller cancels it.

        Raises
        ------
        InvalidOption
            If the loop has been closed.
        """
        with self._calls:
            if self.closed:
                coroutine.close()
                raise InvalidOption("the client is closed: make another one")
            future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def close(self, last: Coroutine[Any, Any, None]) -> None:
        """Run a last coroutine and end the thread; a second call does nothing."""
        with self._calls:  # a later call would wait for a loop that has stopped
            if self.closed:
                last.close()
                return
            self.closed = True
            ended = asyncio.run_coroutine_threadsafe(self._end(last), self._loop)
        ended.result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self, last: Coroutine[Any, Any, None]) -> None:
        """Let the calls of other threads return before the loop stops."""
        await last
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            _, hanging = await asyncio.wait(others, timeout=END_S)
            for task in hanging:
                task.cancel()
            await asyncio.gather(*hanging, return_exceptions=True)
