"""A stream from a source of audio to the outputs: two threads, and Ctrl-C ends it in order."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from service.cli.inputs import open_recording
from service.client import StreamClient, StreamEvent
from service.errors import DoaError

if TYPE_CHECKING:
    from service.doa.types import FloatArray

INTERRUPTED = 130
STOP_TIMEOUT_S = 5.0
"""Seconds of silence after Ctrl-C before the service is left alone"""
CHUNK_S = 0.02

Send = Callable[..., None]


class AudioSource(Protocol):
    """Where audio comes from."""

    audio: dict[str, Any]
    """The fields of ``AudioFormat``"""
    live: bool
    """True where audio gets stale when it waits"""

    def feed(self, send: Send, stopping: threading.Event) -> None:
        """Send everything, or until ``stopping`` is set."""

    def close(self) -> None: ...


class FileSource:
    """A recording, as fast as the service takes it or as fast as it was recorded."""

    def __init__(self, path: Path, *, realtime: bool) -> None:
        self._recording = open_recording(path)
        self.live = realtime
        self.channels = self._recording.channels
        self._rate = self._recording.sample_rate
        self.audio: dict[str, Any] = {
            "encoding": "pcm_f32le",
            "sample_rate": self._rate,
            "channels": self.channels,
            "header": "seq_time" if realtime else "none",
        }

    def feed(self, send: Send, stopping: threading.Event) -> None:
        chunks = self._chunks()
        for chunk in paced(chunks, self._rate, stopping.wait) if self.live else chunks:
            if stopping.is_set():
                return
            send(chunk)

    def close(self) -> None:
        self._recording.close()

    def _chunks(self) -> Iterator[FloatArray]:
        """(T, N) float32, in real time 20 ms each."""
        for block in self._recording.blocks(range(self.channels), self._rate):
            frames = block.T.copy()
            length = max(int(CHUNK_S * self._rate), 1) if self.live else len(frames)
            for start in range(0, len(frames), length):
                yield frames[start : start + length]


def paced(
    chunks: Iterator[FloatArray],
    sample_rate: int,
    wait: Callable[[float], object],
    now: Callable[[], float] = time.monotonic,
) -> Iterator[FloatArray]:
    """Chunks, each when its last sample frame would have been recorded.

    Parameters
    ----------
    chunks : iterator of (T, N)
    sample_rate : int
        Hertz.
    wait, now : callable
        Wait for, and tell, seconds.
    """
    start, done = now(), 0
    for chunk in chunks:
        done += len(chunk)
        ahead = start + done / sample_rate - now()
        if ahead > 0:
            wait(ahead)
        yield chunk


def follow(stream: StreamClient, source: AudioSource, show: Callable[[StreamEvent], None]) -> int:
    """Feed an open stream and show what the service says until it ends.

    Returns
    -------
    code : int
        0, or 130 where the user interrupted it; its last results are shown all the same.

    Raises
    ------
    DoaError
        If the source or the stream fails.
    """
    stopping = threading.Event()
    failures: list[Exception] = []

    def feed() -> None:
        try:
            source.feed(stream.send, stopping)
        except Exception as failure:
            failures.append(failure)
        if not stopping.is_set():
            with suppress(DoaError):  # whoever reads gets it
                stream.stop()

    feeder = threading.Thread(target=feed, name="neuralmusic-feed")
    feeder.start()
    try:
        with _interrupts() as interrupted:
            for event in stream:
                show(event)
                if interrupted.is_set():
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        stopping.set()
        with suppress(DoaError):
            stream.stop(STOP_TIMEOUT_S)
        for event in stream.received():
            show(event)
        return INTERRUPTED
    finally:
        stopping.set()
        feeder.join()
    if failures:
        raise failures[0]
    return 0


@contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """What Ctrl-C sets before it raises: an exception inside of a destructor would be lost."""
    interrupted = threading.Event()

    def note(*_: object) -> None:
        interrupted.set()
        raise KeyboardInterrupt

    handled = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if handled:
        signal.signal(signal.SIGINT, note)
    try:
        yield interrupted
    finally:
        if handled:
            signal.signal(signal.SIGINT, signal.default_int_handler)
