"""The service itself in a thread of the tests, to be started and stopped as often as is needed."""

from __future__ import annotations

import threading

from scripted_service import TIMEOUT_S

from service.api.state import ServiceState
from service.app import create_app
from service.server import Server, server_config
from service.settings import Settings


class RunningService:
    """A running service; ``stop`` drains it as SIGTERM does.

    Parameters
    ----------
    port : int
        0 takes a free one.
    settings : Settings, optional
        One worker by default.
    """

    def __init__(self, port: int = 0, settings: Settings | None = None) -> None:
        settings = settings or Settings(workers=1)
        settings = settings.model_copy(update={"port": port, "log_level": "error"})
        app = self._app = create_app(settings)
        started = threading.Event()
        config = server_config(app, settings)
        self._server = Server(config, app.state.service, lambda _: started.set())
        self._thread = threading.Thread(target=self._server.run)
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
        """Of the processes that compute streams."""
        return self.state.stream_workers.pids

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join(TIMEOUT_S)
