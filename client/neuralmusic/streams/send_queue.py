"""The queue to the service: audio, which is dropped when stale, and control messages."""

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
"""Most control messages in the queue"""

Outgoing = Union[bytes, str]


class SendQueue:
    """A bounded queue of messages; any thread may fill it.

    Parameters
    ----------
    audio_format : AudioFormat
        The format declared in ``start``.
    capacity_s : float
        Most seconds of audio in the queue.
    drop : bool
        Drop the oldest audio beyond that; otherwise the caller waits for ``has_room``.
    wake : callable
        Called after every addition, by the thread that added.
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
        """Messages with their numbers of sample frames, 0 for control messages"""
        self._waiting = 0
        self._dropped = 0
        self._sequence = 0
        self._connected = False
        self._finished = False

    @property
    def has_room(self) -> bool:
        """True while less audio than the capacity waits."""
        return self._waiting < self._capacity

    @property
    def connected(self) -> bool:
        """True between ``begin`` and ``end``."""
        return self._connected

    @property
    def dropped_s(self) -> float:
        """Seconds of audio never sent, over all sessions."""
        return self._dropped / self._format.sample_rate

    @property
    def waiting_s(self) -> float:
        """Seconds of audio in the queue."""
        return self._waiting / self._format.sample_rate

    def begin(self) -> None:
        """Begin a session: sequence numbers start again."""
        with self._lock:
            self._sequence = 0
            self._connected = True

    def end(self) -> None:
        """End a session: waiting audio is stale and dropped, as is audio until the next session."""
        with self._lock:
            self._connected = False
            self._dropped += self._waiting
            self._waiting = 0
            self._entries.clear()

    def add_audio(self, audio: Any, capture_time_ns: int | None = None) -> None:
        """Append audio in pieces, and drop the oldest where there is too much.

        Pieces are numbered when they are added, so the service sees a gap where one was dropped.

        Parameters
        ----------
        audio : bytes-like
            Audio for ``read_frames``.
        capture_time_ns : int, optional
            Capture time of the first sample frame; by default the last one was captured now.

        Raises
        ------
        AudioError, ChannelMismatch
            If the audio is not as declared.
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
        """Append a control message; nothing may follow one with ``last``."""
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
        """Drop one piece, but never the last, so that some audio always gets through."""
        audio = (index for index, (_, frames) in enumerate(self._entries) if frames)
        oldest, following = next(audio, None), next(audio, None)
        if oldest is None or following is None:
            return False
        self._waiting -= self._entries[oldest][1]
        self._dropped += self._entries[oldest][1]
        del self._entries[oldest]
        return True
