"""A worker process of the service and the socket to it."""

from __future__ import annotations

import logging
import socket
import subprocess
import sys
from contextlib import ExitStack

from neuralmusic.errors import Overloaded, TooManyConnections
from service.machine.files import TOO_MANY_FILES, out_of_files
from service.workers.link import worker_environment

log = logging.getLogger(__name__)

READY_S = 30.0
"""Seconds that a worker has to come up before it is killed"""
END_S = 5.0
"""Seconds for a worker to end before it is killed"""


class WorkerProcess:
    """``python -m MODULE FD``, which serves the other end of ``connection``."""

    def __init__(self, module: str) -> None:
        with ExitStack() as opened:
            try:
                self.connection, theirs = socket.socketpair()
                opened.enter_context(self.connection)
                with theirs:
                    self._process = subprocess.Popen(
                        [sys.executable, "-m", module, str(theirs.fileno())],
                        pass_fds=[theirs.fileno()],
                        # Decoders print there what they find wrong; logs go to stderr.
                        stdout=subprocess.DEVNULL,
                        env=worker_environment(),
                    )
            except OSError as error:
                log.error("no worker process can be started: %s", error)
                if out_of_files(error):
                    raise TooManyConnections(TOO_MANY_FILES) from error
                raise Overloaded("the system starts no further process: try again later") from error
            opened.pop_all()
        self.pid = self._process.pid

    @property
    def alive(self) -> bool:
        """False once the process has ended."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill the process; its reader notices by the socket."""
        self._process.kill()

    def end(self) -> int | None:
        """Close the socket, wait for the process; its exit status, negative for a signal.

        None where the system cannot end it, as while it reads a file system that hangs.
        """
        self.connection.close()
        for _ in range(2):
            try:
                return self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return None
