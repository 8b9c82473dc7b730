"""Messages between the service and its worker processes, over a private socket pair.

Messages are pickled: both ends are this program, a client's bytes are never unpickled, and no
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
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.inference.bundle import BundleFiles
from service.inference.registry import BundleRegistry
from service.machine.environment import VARIABLES
from service.observability.logs import configure_logging
from service.settings import Settings

HEADER = struct.Struct("<I")
READ_BYTES = 2**16
"""Most bytes in one read: a stream's job or its outcome is smaller"""
READY = "ready"
TAKEN = "taken"


@dataclass(frozen=True, slots=True)
class Setup:
    """The first message to a worker: its settings and models."""

    settings: Settings
    bundles: tuple[BundleFiles, ...]


def packed(message: object) -> bytes:
    """A pickled message behind its length."""
    data = pickle.dumps(message, protocol=5)
    return HEADER.pack(len(data)) + data


class Unpacker:
    """Reassembles messages from pieces of any size."""

    def __init__(self) -> None:
        self._held = bytearray()

    def add(self, data: bytes) -> None:
        """Take the next bytes."""
        self._held += data

    def messages(self) -> Iterator[Any]:
        """The complete messages, in order."""
        while len(self._held) >= HEADER.size:
            end = HEADER.size + HEADER.unpack_from(self._held)[0]
            if len(self._held) < end:
                return
            message = pickle.loads(self._held[HEADER.size : end])
            del self._held[:end]
            yield message


class Link:
    """One end of the socket, blocking."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._unpacker = Unpacker()
        self._files: deque[int] = deque()

    def send(self, message: object, files: Sequence[int] = ()) -> None:
        """Send one message, and file descriptors with it; safe to call from several threads."""
        data = packed(message)
        with self._lock:
            sent = socket.send_fds(self._connection, [data], files) if files else 0
            self._connection.sendall(data[sent:])

    def receive(self) -> Any:
        """The next message; raises EOFError once the other end is gone, or TimeoutError."""
        return self.receive_with_file()[0]

    def receive_with_file(self) -> tuple[Any, int | None]:
        """The next message and the file descriptor that came with it; the caller closes it."""
        while True:
            for message in self._unpacker.messages():
                return message, self._files.popleft() if self._files else None
            data, files, _, _ = socket.recv_fds(self._connection, READ_BYTES, 1)
            if not data:
                raise EOFError
            self._files.extend(files)
            self._unpacker.add(data)


def run_worker(serve: Callable[[Link, Settings, BundleRegistry], None]) -> None:
    """Run a worker: set it up, then serve the socket whose descriptor is the argument.

    The worker ends with the socket, so that it never outlives the service, which handles signals.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as connection, suppress(EOFError, OSError):
        link = Link(connection)
        setup: Setup = link.receive()
        settings = setup.settings
        configure_logging(settings, f"{Path(sys.argv[0]).stem}_worker-{os.getpid()}")
        serve(link, settings, BundleRegistry.of_files(setup.bundles))


def worker_environment() -> dict[str, str]:
    """The environment of a worker process."""
    return {
        **VARIABLES,
        **os.environ,
        # A stream's or window's matrices are small: threads of the linear algebra cost more than
        # they gain.
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
