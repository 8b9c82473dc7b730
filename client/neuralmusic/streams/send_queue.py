"""What waits to be sent: audio that is dropped when it gets stale, and control messages."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Union

from neuralmusic.client_errors import StreamClosed
from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.framing import NANOSECONDS, FrameHeader
from neuralmusic.streams.audio import read_frames, split_frames

MAX_CONTROL = 64
"""Control messages that wait at most"""

Outgoing = Union[bytes, str]


class SendQueue:
    """A bounded queue of messages in their order; any thread may fill it.

    Parameters
    ----------
    audio_format : AudioFormat
        As declared in ``start``.
    capacity_s : float
        Seconds of audio that may wait.
    drop : bool
        Drop the oldest audio when there is more; otherwise the caller waits for ``has_room``.
    wake : callable
        Called after something was added, by the thread that added it.
    """

    def __init__(
        self, audio_format: AudioFormat, capacity_s: float, *, drop: bool, wake: Callable[[], None]
    ) -> None:
        self._format = audio_format
        self._capacity = max(int(capacity_s * audio_format.sample_rate), 1)
        self._drop = drop
        self._wake = wake
        self._lock = threading.Lock()
        self._entries: deque[tuple[Outgoing, int]] = deque()
        """Each with its sample frames; control messages have none"""
        self._waiting = 0
        self._dropped = 0
        self._sequence = 0
        self._connected = False
        self._finished = False

    @property
    def has_room(self) -> bool:
        """True where less than the capacity waits."""
        return self._waiting < self._capacity

    @property
    def connected(self) -> bool:
        """True between ``begin`` and ``end``."""
        return self._connected

    @property
    def dropped_s(self) -> float:
        """Seconds of audio that were never sent, of all sessions."""
        return self._dropped / self._format.sample_rate

    @property
    def waiting_s(self) -> float:
        """Seconds of audio that wait now."""
        return self._waiting / self._format.sample_rate

    def begin(self) -> None:
        """A session begins: sequence numbers start again."""
        with self._lock:
            self._sequence = 0
            self._connected = True

    def end(self) -> None:
        """A session ended: what waits is stale and dropped, and so is what comes meanwhile."""
        with self._lock:
            self._connected = False
            self._dropped += self._waiting
            self._waiting = 0
            self._entries.clear()

    def add_audio(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Append audio in pieces, and drop the oldest where there is too much.

        Every piece has its sequence number from the beginning, so the service sees a gap where
        one was dropped.

        Parameters
        ----------
        audio : bytes-like
            As ``read_frames`` takes it.
        capture_time_ns : int, optional
            When its first sample frame was captured; by default its last one was captured now.

        Raises
        ------
        AudioError, ChannelMismatch
            If it is not as declared.
        StreamClosed
            After ``add_text(..., last=True)``.
        """
        frames = read_frames(audio, self._format)
        size = self._format.frame_bytes
        if capture_time_ns is None:
            length = len(frames) // size * NANOSECONDS // self._format.sample_rate
            capture_time_ns = time.time_ns() - length
        with self._lock:
            self._check_open()
            if not self._connected:
                self._dropped += len(frames) // size
                return
            for piece, captured_ns in split_frames(frames, self._format, capture_time_ns):
                self._entries.append((self._message(piece, captured_ns), len(piece) // size))
                self._waiting += len(piece) // size
            while self._drop and self._waiting > self._capacity and self._drop_oldest():
                pass
        self._wake()

    def add_text(self, text: str, *, last: bool = False) -> None:
        """Append a control message; with ``last`` nothing may follow it."""
        with self._lock:
            self._check_open()
            self._finished = last
            if not self._connected:
                return
            control = [index for index, (_, frames) in enumerate(self._entries) if not frames]
            if len(control) >= MAX_CONTROL:
                del self._entries[control[0]]
            self._entries.append((text, 0))
        self._wake()

    def take(self) -> Outgoing | None:
        """The oldest message, or None."""
        with self._lock:
            if not self._entries:
                return None
            message, frames = self._entries.popleft()
            self._waiting -= frames
            return message

    def _check_open(self) -> None:
        if self._finished:
            raise StreamClosed(
                "stopped", "Stream stopped", "the stream was stopped: open another for more audio"
            )

    def _message(self, piece: memoryview, captured_ns: int) -> bytes:
        if self._format.header == "none":
            return bytes(piece)
        header = FrameHeader(self._sequence, captured_ns).pack()
        self._sequence += 1
        return header + piece

    def _drop_oldest(self) -> bool:
        """Drop one piece; never the last, so that something always comes through."""
        audio = (index for index, (_, frames) in enumerate(self._entries) if frames)
        oldest, following = next(audio, None), next(audio, None)
        if oldest is None or following is None:
            return False
        self._waiting -= self._entries[oldest][1]
        self._dropped += self._entries[oldest][1]
        del self._entries[oldest]
        return True
