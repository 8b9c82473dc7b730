"""What the service and its worker processes say to each other, over a private socket pair.

Messages are pickled: both ends are this program, nothing of a client's is ever unpickled, and no
other process can reach the socket, which has no name.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.inference.bundle import BundleFiles
from service.inference.registry import BundleRegistry
from service.logs import configure_logging
from service.settings import Settings

HEADER = struct.Struct("<I")
READY = "ready"


@dataclass(frozen=True, slots=True)
class Setup:
    """The first message to a worker: what it runs with."""

    settings: Settings
    bundles: tuple[BundleFiles, ...]


def packed(message: object) -> bytes:
    """A message with its length before it."""
    data = pickle.dumps(message, protocol=5)
    return HEADER.pack(len(data)) + data


class Link:
    """One end of the socket, blocking."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def send(self, message: object, files: Sequence[int] = ()) -> None:
        """Send one message, and file descriptors with it; safe to call from several threads."""
        data = packed(message)
        with self._lock:
            sent = socket.send_fds(self._connection, [data], files) if files else 0
            self._connection.sendall(data[sent:])

    def receive(self) -> Any:
        """The next message; EOFError once the other end is gone, TimeoutError after a timeout."""
        return self.receive_with_file()[0]

    def receive_with_file(self) -> tuple[Any, int | None]:
        """The next message and the file descriptor that came with it, which is the caller's."""
        head, files, _, _ = socket.recv_fds(self._connection, HEADER.size, 1)
        if not head:
            raise EOFError
        head += self._exactly(HEADER.size - len(head))
        (length,) = HEADER.unpack(head)
        return pickle.loads(self._exactly(length)), files[0] if files else None

    def _exactly(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            piece = self._connection.recv(count - len(data))
            if not piece:
                raise EOFError
            data += piece
        return bytes(data)


def run_worker(serve: Callable[[Link, Settings, BundleRegistry], None]) -> None:
    """A worker's whole life: set up, serve the socket whose descriptor is the argument, end.

    It ends when the socket does, so that it never outlives the service, and leaves signals to it.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as connection, suppress(EOFError, OSError):
        link = Link(connection)
        setup: Setup = link.receive()
        settings = setup.settings
        configure_logging(settings, f"{Path(sys.argv[0]).stem}-{os.getpid()}")
        serve(link, settings, BundleRegistry.of_files(setup.bundles))


def worker_environment() -> dict[str, str]:
    """The environment of a worker process."""
    return {
        **os.environ,
        # One stream's or window's matrices are small: threads of the linear algebra only cost.
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
