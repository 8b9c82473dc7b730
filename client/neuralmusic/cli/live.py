"""A stream from a source of audio to the outputs: two threads, ended gracefully by Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from neuralmusic.errors import DoaError
from neuralmusic.sources.source import AudioSource
from neuralmusic.streams.inbox import StreamEvent
from neuralmusic.streams.stream import StreamClient

INTERRUPTED = 130
STOP_TIMEOUT_S = 5.0
"""Seconds to wait for the service's last messages after Ctrl-C"""


def follow(stream: StreamClient, source: AudioSource, show: Callable[[StreamEvent], None]) -> int:
    """Feed an open stream and show the service's messages until it ends.

    Returns
    -------
    code : int
        0, or 130 where the user interrupted it; the last results are shown in both cases.

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
            with suppress(DoaError):  # the reader gets it
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
    """An event that Ctrl-C sets before it raises: an exception in a destructor would be lost."""
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
