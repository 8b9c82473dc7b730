"""A stream for asyncio: audio goes in, directions come out, and lost connections are renewed.

::

    async with AsyncStreamClient(
        "http://robot:8000",
        array="respeaker-usb-4mic-v2",
        audio={"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
    ) as stream:
        await stream.send(chunk)
        async for event in stream:
            ...
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from typing_extensions import Self

from neuralmusic.protocol.server_messages import Summary
from neuralmusic.streams.controls import StreamControls
from neuralmusic.streams.inbox import StreamEvent


class AsyncStreamClient(StreamControls):
    """A stream that reconnects; iterating yields the service's messages."""

    async def open(self) -> Self:
        """Connect and wait for ``ready``.

        Raises
        ------
        ServiceUnreachable
            If nothing answers, within ``wait_s`` where that is given.
        StreamRefused
            If the service refuses.
        """
        await self._sessions.open()
        return self

    async def close(self) -> None:
        """End the connection at once, without the last results; a second call does nothing."""
        await self._sessions.close()

    async def send(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Send audio; never waits for the network, except where ``overflow`` is ``block``.

        Parameters
        ----------
        audio : bytes-like
            Interleaved samples as declared: bytes, or an array (T, N) of int16, int32 or float32.
        capture_time_ns : int, optional
            Capture time of the first sample frame, for ``header: "seq_time"``; by default the last
            one was captured now.

        Raises
        ------
        AudioError, ChannelMismatch
            If the audio is not as declared.
        StreamClosed
            If the stream has ended.
        """
        await self._sessions.send(audio, capture_time_ns)
        await asyncio.sleep(0)  # let the connection work, even if the caller only sends

    def post(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """``send`` without waiting for room, from any thread: for an audio device's callback."""
        self._sessions.post(audio, capture_time_ns)

    async def stop(self, timeout_s: float = 30.0) -> Summary:
        """Send waiting audio, end the session and wait for its summary.

        The last results can still be read afterwards.

        Parameters
        ----------
        timeout_s : float
            Seconds without any message from the service after which to give up.

        Raises
        ------
        StreamClosed, ServiceUnreachable
            If the session ended without a summary, or the service is silent.
        """
        return await self._sessions.stop(timeout_s)

    async def receive(self, timeout_s: float | None = None) -> StreamEvent | None:
        """The next event; None where none came in time, or the stream has ended (``ended``).

        Raises
        ------
        StreamClosed, StreamRefused, ServiceUnreachable
            After the last event, where the stream ended with an error.
        """
        await self.wait(timeout_s)
        return self.take()

    async def wait(self, timeout_s: float | None = None) -> None:
        """Wait until there is an event to receive, or the stream has ended."""
        await self._sessions.inbox.wait(timeout_s)

    async def __aiter__(self) -> AsyncIterator[StreamEvent]:
        while (event := await self.receive()) is not None:
            yield event

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        await self.close()
