"""A stream for programs without asyncio: the same as ``AsyncStreamClient``, which runs in a thread.

::

    with StreamClient(
        "http://robot:8000",
        array="respeaker-usb-4mic-v2",
        audio={"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
    ) as stream:
        for chunk in chunks:
            stream.send(chunk)
            for event in stream.received():
                ...
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Iterator
from types import TracebackType
from typing import Any, Self, TypeVar

from service.client.async_stream import NOT_OPEN, AsyncStreamClient
from service.client.inbox import StreamEvent
from service.errors import InvalidOption
from service.protocol.client_messages import Start
from service.protocol.server_messages import Ready, Result, Summary

T = TypeVar("T")
END_S = 1.0
"""Seconds for other threads' calls to return when the stream is closed"""


class StreamClient:
    """A stream that reconnects; iterating yields what the service says and ends with the stream.

    Parameters
    ----------
    url, start, **options
        As ``AsyncStreamClient`` takes them.

    Notes
    -----
    One thread may send while another reads. What it stands on, one event loop in a background
    thread, ends with the ``with`` block.
    """

    def __init__(self, url: str, start: Start | None = None, **options: Any) -> None:
        self._client = AsyncStreamClient(url, start, **options)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._calls = threading.Lock()
        self._closed = False

    @property
    def ready(self) -> Ready:
        """What is in effect; another one, with another session, after a reconnection."""
        return self._client.ready

    @property
    def connected(self) -> bool:
        """True while a session runs."""
        return self._client.connected

    @property
    def ended(self) -> bool:
        """True where everything was read and nothing will come."""
        return self._client.ended

    @property
    def latest(self) -> Result | None:
        """The newest result, read or not."""
        return self._client.latest

    @property
    def summary(self) -> Summary | None:
        """The session as a whole, once it has ended in order."""
        return self._client.summary

    @property
    def dropped_s(self) -> float:
        """Seconds of audio that were dropped before they were sent."""
        return self._client.dropped_s

    @property
    def results_dropped(self) -> int:
        """Results that were dropped since nobody read them."""
        return self._client.results_dropped

    def open(self) -> Self:
        """Connect and wait for ``ready``.

        Raises
        ------
        ServiceUnreachable
            If nothing answers, within ``wait_s`` where that is given.
        StreamRefused
            If the service says no.
        """
        if self._thread is not None:
            raise InvalidOption("the stream is open already, or was: make another one")
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="neuralmusic-stream", daemon=True
        )
        self._thread.start()
        try:
            self._call(self._client.open())
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """End the connection at once, without the last results; again does nothing."""
        loop, thread = self._loop, self._thread
        if loop is None or thread is None:
            return
        with self._calls:  # a call that came later would wait for a loop that has stopped
            if self._closed:
                return
            self._closed = True
            ended = asyncio.run_coroutine_threadsafe(self._end(), loop)
        ended.result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

    def send(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Send audio; never waits, except where ``overflow`` is ``block``.

        Any thread may call it, an audio device's callback, too.

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
        if self._client.live:
            self._client.post(audio, capture_time_ns)
        else:
            self._call(self._client.send(audio, capture_time_ns))

    def update(self, **changes: Any) -> None:
        """Change output options (``interval_ms``, ``yaw_deg``, ...) from the next result on."""
        self._client.update(**changes)

    def flush(self) -> None:
        """Localize what was sent so far now; ``Flushed`` follows the last of these results."""
        self._client.flush()

    def ping(self, id: int | None = None) -> None:
        """Ask for a ``Pong`` with this number."""
        self._client.ping(id)

    def calibrate(self, seconds: float = 5.0) -> None:
        """Learn the robot's noise from the audio that follows; ``Calibrated`` tells the end."""
        self._client.calibrate(seconds)

    def stop(self, timeout_s: float = 30.0) -> Summary:
        """Send what waits, end the session and wait for its summary, as ``AsyncStreamClient``."""
        return self._call(self._client.stop(timeout_s))

    def receive(self, timeout_s: float | None = None) -> StreamEvent | None:
        """The next event; None where none came in time, or the stream has ended (``ended``).

        Raises
        ------
        StreamClosed, StreamRefused, ServiceUnreachable
            After the last event, where the stream ended with an error.
        """
        event = self._client.take()
        if event is None and not (self._client.ended or self._closed):
            try:
                self._call(self._client.wait(timeout_s))
            except InvalidOption:
                if not self._closed:
                    raise
            event = self._client.take()  # here: a wait that is interrupted must not lose an event
        return event

    def received(self) -> list[StreamEvent]:
        """Everything that has come and was not read, without waiting."""
        return self._client.received()

    def __iter__(self) -> Iterator[StreamEvent]:
        while (event := self.receive()) is not None:
            yield event

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    async def _end(self) -> None:
        """Close, and let the calls of other threads return before the loop stops."""
        await self._client.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            _, hanging = await asyncio.wait(others, timeout=END_S)
            for task in hanging:
                task.cancel()
            await asyncio.gather(*hanging, return_exceptions=True)

    def _call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run in the thread's loop; an interrupted caller takes its call back."""
        with self._calls:
            if self._loop is None or self._closed:
                coroutine.close()
                raise InvalidOption(NOT_OPEN)
            future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise
