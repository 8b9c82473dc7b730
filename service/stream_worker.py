"""A worker process: streams' work comes in over a socket, what came of it goes out.

The service starts it as ``python -m service.stream_worker FD``. It ends when the socket does, so
that it never outlives the service, and leaves signals to it.
"""

from __future__ import annotations

import pickle
import signal
import socket
import struct
import sys
import threading
import time
from queue import SimpleQueue
from typing import Any

from service.settings import Settings
from service.startup import load_registry, warm_up
from service.streaming.host import StreamHost
from service.streaming.work import Check, Work

HEADER = struct.Struct("<I")
READY = "ready"
CHECK_DUTY = 0.03
"""Share of the time that looks at channels may take: a tenth of a second slows the results of all
streams of this worker, so with many streams they take turns"""


def packed(message: object) -> bytes:
    """A message with its length before it; both ends are this program."""
    data = pickle.dumps(message, protocol=5)
    return HEADER.pack(len(data)) + data


class Link:
    """The worker's end of the socket."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def send(self, message: object) -> None:
        """Send one message; safe to call from several threads."""
        with self._lock:
            self._connection.sendall(packed(message))

    def receive(self) -> Any:
        """The next message; EOFError once the service is gone."""
        (length,) = HEADER.unpack(self._exactly(HEADER.size))
        return pickle.loads(self._exactly(length))

    def _exactly(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            piece = self._connection.recv(count - len(data))
            if not piece:
                raise EOFError
            data += piece
        return bytes(data)


def work_until_end(link: Link, host: StreamHost) -> None:
    """Do work in the order in which it comes, looks at channels beside it."""
    checks: SimpleQueue[tuple[int, Check]] = SimpleQueue()
    threading.Thread(target=_check_forever, args=(link, host, checks), daemon=True).start()
    while True:
        number, work = _received(link)
        if isinstance(work, Check):
            checks.put((number, work))
            continue
        outcome = host.perform(work)
        if outcome is not None:
            link.send((number, outcome))


def _received(link: Link) -> tuple[int, Work]:
    number, work = link.receive()
    return number, work


def _check_forever(link: Link, host: StreamHost, checks: SimpleQueue[tuple[int, Check]]) -> None:
    while True:
        number, check = checks.get()
        began = time.monotonic()
        outcome = host.perform(check)
        try:
            link.send((number, outcome))
        except OSError:
            return
        time.sleep((time.monotonic() - began) * (1 / CHECK_DUTY - 1))


def main() -> None:
    """Serve the socket whose file descriptor is the argument."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        link = Link(connection)
        try:
            settings: Settings = link.receive()
            registry = load_registry(settings)
            warm_up(registry)
            link.send((0, READY))
            work_until_end(link, StreamHost(registry))
        except (EOFError, OSError):
            pass


if __name__ == "__main__":
    main()
