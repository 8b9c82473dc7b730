"""One process of the service: uvicorn with limits, announced once it listens."""

from __future__ import annotations

import socket
from collections.abc import Callable

import uvicorn

from service.app import create_app, load_registry
from service.settings import Settings

GRACE = 10
"""Seconds that running requests get to finish after SIGTERM"""


class Server(uvicorn.Server):
    """uvicorn that tells its address once it accepts connections."""

    def __init__(self, config: uvicorn.Config, announce: Callable[[str], None] | None) -> None:
        super().__init__(config)
        self._announce = announce

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self._announce and self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            self._announce(f"http://{f'[{host}]' if ':' in host else host}:{port}")


def serve(settings: Settings, announce: Callable[[str], None] | None = None) -> None:
    """Serve until SIGINT or SIGTERM; ``announce`` is called with the address once ready.

    Raises
    ------
    BundleError, ConfigError
        If the bundles cannot be loaded: nothing listens then.
    """
    app = create_app(settings, load_registry(settings))
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level,
        server_header=False,
        timeout_graceful_shutdown=GRACE,
        ws="none",
    )
    Server(config, announce).run()
