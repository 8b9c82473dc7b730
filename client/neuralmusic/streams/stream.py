"""A stream for programs without asyncio: the same as ``AsyncStreamClient``, in a thread.

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

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from typing_extensions import Self

from neuralmusic.errors import InvalidOption
from neuralmusic.loop_thread import LoopThread
from neuralmusic.protocol.server_messages import Summary
from neuralmusic.streams.controls import StreamControls
from neuralmusic.streams.inbox import StreamEvent
from neuralmusic.streams.sessions import NOT_OPEN, OPEN_ALREADY


class StreamClient(StreamControls):
    """A stream that reconnects; iterating yields the service's messages and ends with the stream.

    Notes
    -----
    One thread may send while another reads. One event loop in a background thread does the work;
    it ends with the ``with`` block.
    """

    _thread: LoopThread | None = None

    def open(self) -> Self:
        """Connect and wait for ``ready``, as ``AsyncStreamClient.open``."""
        if self._thread is not None:
            raise InvalidOption(OPEN_ALREADY)
        self._thread = LoopThread()
        try:
            self._thread.run(self._sessions.open())
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """End the connection at once, without the last results; a second call does nothing."""
        if self._thread is not None:
            self._thread.close(self._sessions.close())

    def send(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Send audio, as ``AsyncStreamClient.send``; never waits, unless ``overflow`` is ``block``.

        Any thread may call it, including an audio device's callback.
        """
        if self.live:
            self._sessions.post(audio, capture_time_ns)
        else:
            self._loop.run(self._sessions.send(audio, capture_time_ns))

    def stop(self, timeout_s: float = 30.0) -> Summary:
        """Send waiting audio, end the session, wait for its summary, as ``AsyncStreamClient``."""
        return self._loop.run(self._sessions.stop(timeout_s))

    def receive(self, timeout_s: float | None = None) -> StreamEvent | None:
        """The next event; None where none came in time, or the stream has ended (``ended``).

        Raises
        ------
        StreamClosed, StreamRefused, ServiceUnreachable
            After the last event, where the stream ended with an error.
        """
        loop, event = self._loop, self.take()
        if event is None and not (self.ended or loop.closed):
            with suppress(InvalidOption):  # another thread has closed it meanwhile
                loop.run(self._sessions.inbox.wait(timeout_s))
            event = self.take()  # in this thread: an interrupted wait must not lose an event
        return event

    def __iter__(self) -> Iterator[StreamEvent]:
        while (event := self.receive()) is not None:
            yield event

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _loop(self) -> LoopThread:
        if self._thread is None:
            raise InvalidOption(NOT_OPEN)
        return self._thread
