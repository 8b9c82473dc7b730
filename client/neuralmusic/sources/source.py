"""The interface of every source of audio, and the pace of a recording."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

CHUNK_S = 0.02
"""Seconds of audio that a live source sends at a time"""

Send = Callable[..., None]


class AudioSource(Protocol):
    """A source of audio."""

    audio: dict[str, Any]
    """Fields of ``AudioFormat``"""
    live: bool
    """True where waiting audio becomes stale"""

    def feed(self, send: Send, stopping: threading.Event) -> None:
        """Send all audio, or until ``stopping`` is set."""

    def close(self) -> None: ...


def paced(
    chunks: Iterator[bytes],
    bytes_per_second: float,
    wait: Callable[[float], object],
    now: Callable[[], float] = time.monotonic,
) -> Iterator[bytes]:
    """Yield each chunk at the time at which its last sample frame would have been recorded.

    Parameters
    ----------
    chunks : iterator of bytes
    bytes_per_second : float
        Bytes of a second of audio, all channels.
    wait, now : callable
        Wait for a number of seconds; tell the time in seconds.
    """
    start, done = now(), 0
    for chunk in chunks:
        done += len(chunk)
        ahead = start + done / bytes_per_second - now()
        if ahead > 0:
            wait(ahead)
        yield chunk
