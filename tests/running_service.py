"""The service itself in a thread of the tests, to be started and stopped as often as is needed."""

from __future__ import annotations

import threading

import uvicorn
from scripted_service import TIMEOUT_S

from service.app import create_app
from service.server import Server
from service.settings import Settings


class RunningService:
    """A running service; ``stop`` drains it as SIGTERM does.

    Parameters
    ----------
    port : int
        0 takes a free one.
    """

    def __init__(self, port: int = 0) -> None:
        app = create_app(Settings(workers=1))
        started = threading.Event()
        config = uvicorn.Config(
            app,
            port=port,
            log_level="error",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
        )
        self._server = Server(config, app.state.service, lambda _: started.set())
        self._thread = threading.Thread(target=self._server.run)
        self._thread.start()
        assert started.wait(TIMEOUT_S)
        self.port: int = self._server.servers[0].sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join(TIMEOUT_S)
