"""The service itself, in a thread of the tests or in a process, started as often as is needed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from scripted_service import TIMEOUT_S

from service.api.state import ServiceState
from service.app import create_app
from service.server import Server, server_config
from service.settings import Settings

ROOT = Path(__file__).parents[2]


@contextmanager
def serving(**settings: str) -> Iterator[str]:
    """The address of a service of its own process on a free port."""
    command = [sys.executable, "-m", "neuralmusic", "serve", "--port", "0"]
    # Nobody reads the pipe after the first line: it must not fill up.
    environment = {**os.environ, "NEURALMUSIC_LOG_LEVEL": "warning", **settings}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            yield re.findall(r"http://\S+", process.stdout.readline())[0]
        finally:
            process.terminate()


async def workers_with_the_first_work(self: ServiceState) -> None:
    """In the place of ``start_workers``: a worker is started when something comes for it."""


WORKERS_LATER = """
from running_service import workers_with_the_first_work
from service.api.state import ServiceState
ServiceState.start_workers = workers_with_the_first_work
"""
"""First lines of a program that does the same in a process of its own"""


class RunningService:
    """A running service; ``stop`` drains it as SIGTERM does.

    Parameters
    ----------
    port : int
        0 takes a free one.
    settings : Settings, optional
        One worker by default.
    workers_ahead : bool
        Start a worker of each kind before the first client comes, as the service does by itself;
        each takes seconds.
    """

    def __init__(
        self, port: int = 0, settings: Settings | None = None, *, workers_ahead: bool = False
    ) -> None:
        settings = settings or Settings(workers=1)
        settings = settings.model_copy(update={"port": port, "log_level": "error"})
        app = self._app = create_app(settings)
        started = threading.Event()
        config = server_config(app, settings)
        self._server = Server(config, app.state.service, lambda _: started.set())
        self._thread = threading.Thread(target=self._server.run)
        start = ServiceState.start_workers if workers_ahead else workers_with_the_first_work
        with patch.object(ServiceState, "start_workers", start):
            self._thread.start()
            assert started.wait(TIMEOUT_S)
        self.port: int = self._server.servers[0].sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    @property
    def state(self) -> ServiceState:
        """What its endpoints share."""
        state: ServiceState = self._app.state.service
        return state

    @property
    def worker_pids(self) -> list[int]:
        """Ids of the processes that compute streams."""
        return self.state.stream_workers.pids

    def begin_stop(self) -> None:
        self._server.should_exit = True

    def end_delay(self) -> None:
        """Proceed as if the setting ``drain_delay_s`` had passed."""
        state = self._app.state.service
        state.settings = state.settings.model_copy(update={"drain_delay_s": 0.0})

    def stop(self) -> None:
        self.begin_stop()
        self._thread.join(TIMEOUT_S)
        assert not self._thread.is_alive()
