"""One process of the service: uvicorn with limits, announced once it listens."""

from __future__ import annotations

import asyncio
import logging
import math
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress

import uvicorn
from fastapi import FastAPI

from service.api.state import ServiceState
from service.app import create_app
from service.errors import ReloadRefused
from service.settings import Settings
from service.startup import load_registry

WS_MAX_SIZE = 2**20
"""Bytes of a WebSocket message; the stream says what is wrong from 64 KiB on, beyond this only a
close frame does"""
FAREWELL = 5
"""Seconds in which streams get their last words, and then those whose recordings took too long"""


class Server(uvicorn.Server):
    """uvicorn that tells its address once it listens, and tells clients when it stops."""

    def __init__(
        self,
        config: uvicorn.Config,
        state: ServiceState,
        announce: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(config)
        self._state = state
        self._announce = announce
        self._reloads: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await self._state.load()
        await self._state.start_workers()
        await super().startup(sockets)
        with suppress(NotImplementedError, ValueError, RuntimeError):  # no signals there
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, self._hang_up)
        if self._announce and self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            self._announce(f"http://{f'[{host}]' if ':' in host else host}:{port}")

    def _hang_up(self) -> None:
        """SIGHUP: read the models again, as daemons read their configuration."""

        async def reload() -> None:
            with suppress(ReloadRefused):  # it was logged
                await self._state.reload()

        task = asyncio.get_running_loop().create_task(reload())
        self._reloads.add(task)
        task.add_done_callback(self._reloads.discard)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._wait_for_proxies()
        grace = self._state.settings.drain_grace
        asyncio.get_running_loop().call_later(grace, self._state.recording_workers.drain)
        # uvicorn would cut the sockets before the application hears of it.
        self._state.streams.drain()
        with suppress(TimeoutError):
            async with asyncio.timeout(FAREWELL):
                await self._state.streams.empty.wait()
        await super().shutdown(sockets)

    async def _wait_for_proxies(self) -> None:
        """Say that no more should come, but take what does: a proxy looks only now and then."""
        state = self._state
        state.leaving = True
        began = time.monotonic()
        while time.monotonic() - began < state.settings.drain_delay:
            if self.force_exit:  # which uvicorn itself looks at now and then
                return
            await asyncio.sleep(0.1)


def serve(settings: Settings, announce: Callable[[str], None] | None = None) -> None:
    """Serve until SIGINT or SIGTERM; ``announce`` is called with the address once ready.

    Call it from the main thread: after SIGTERM the process ends with exit code 0.

    Raises
    ------
    BundleError, ConfigError
        If the bundles cannot be loaded: nothing listens then.
    """
    # uvicorn raises a signal again once it has drained, which would look like a failure; and the
    # first process of a container ignores SIGTERM until somebody handles it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    app = create_app(settings, load_registry(settings))
    Server(server_config(app, settings), app.state.service, announce).run()


def quiet_refusals(record: logging.LogRecord) -> bool:
    """uvicorn takes a handshake that was refused with a response for one that was forgotten."""
    return "returned without completing handshake" not in record.getMessage()


def server_config(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """How uvicorn runs the application."""
    logging.getLogger("uvicorn.error").addFilter(quiet_refusals)
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level,
        server_header=False,
        timeout_graceful_shutdown=math.ceil(settings.drain_grace) + FAREWELL,
        ws="websockets-sansio",
        ws_max_size=WS_MAX_SIZE,
        ws_per_message_deflate=False,
    )
