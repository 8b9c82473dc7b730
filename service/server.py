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
from typing import Any

import uvicorn
from fastapi import FastAPI

from service.api.middleware.hosts import is_loopback
from service.api.state import ServiceState
from service.app import create_app
from service.connections.client_socket import Reception
from service.connections.http import HttpProtocol, limit_untaken
from service.connections.places import Places
from service.connections.websocket import StreamProtocol
from service.errors import ReloadRefused
from service.lifecycle import Phase
from service.machine.files import file_limit, out_of_files, raise_file_limit
from service.observability.logs import RareLine, configure_logging, server_log_level
from service.settings import Settings
from service.startup import load_registry

log = logging.getLogger(__name__)

WS_MAX_SIZE = 2**20
"""Bytes of a WebSocket message; the stream says what is wrong from 64 KiB on, beyond this only a
close frame does"""
ACCEPTED_AT_ONCE = 8
"""Connections between two looks at the streams"""
BACKLOG = 1024
"""Connections that the system holds until they are accepted"""
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
        self.server_state = self._places = Places.of(state.settings, file_limit())
        self._told = RareLine(log)
        self._reloads: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await self._state.load()
        await self._state.start_workers()
        await super().startup(sockets)
        for listening in (each for server in self.servers for each in server.sockets):
            limit_untaken(listening)
            with socket.fromfd(listening.fileno(), listening.family, listening.type) as same:
                same.listen(BACKLOG)  # what asyncio was told is how many it accepts at once
        asyncio.get_running_loop().set_exception_handler(self._on_loop_error)
        with suppress(NotImplementedError, ValueError, RuntimeError):  # no signals there
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, self._hang_up)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGHUP})
        if self._announce and self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            self._announce(f"http://{f'[{host}]' if ':' in host else host}:{port}")

    def _on_loop_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Say once a minute that no connection can be accepted, instead of with every attempt."""
        if out_of_files(context.get("exception")):
            self._places.make_room()
            self._told.warning(
                "no connection can be accepted: %s; raise the limit of open files (ulimit -n)",
                context["exception"],
            )
        else:
            loop.default_exception_handler(context)

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
        grace = self._state.settings.drain_grace_s
        lifecycle = self._state.lifecycle
        asyncio.get_running_loop().call_later(grace, lifecycle.enter, Phase.ENDING)
        # uvicorn would cut the sockets before the application hears of it.
        self._state.drain()
        with suppress(TimeoutError):
            async with asyncio.timeout(FAREWELL):
                await self._state.streams.empty.wait()
        await super().shutdown(sockets)

    async def _wait_for_proxies(self) -> None:
        """Report not ready, keep accepting: a proxy looks only now and then."""
        state = self._state
        state.lifecycle.enter(Phase.LEAVING)
        began = time.monotonic()
        while time.monotonic() - began < state.settings.drain_delay_s:
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
    configure_logging(settings)
    raise_file_limit()
    warn_if_open(settings)
    # uvicorn raises a signal again once it has drained, which would look like a failure; and the
    # first process of a container ignores SIGTERM until somebody handles it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if sys.platform != "win32":
        # It would end the process: until somebody handles it, the system keeps it.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    app = create_app(settings, load_registry(settings))
    Server(server_config(app, settings), app.state.service, announce).run()


def warn_if_open(settings: Settings) -> None:
    """Say loudly that everybody in the network may do everything, where that is so."""
    if settings.keys is None and not is_loopback(settings.host):
        log.warning(
            "NO API KEYS: the service listens on %s, and whoever reaches it there may localize, "
            "stream, watch every stream, change noise profiles and reload models. Make a key with "
            "`neuralmusic key new NAME --roles localize,stream --file keys.jsonl`, start with "
            "NEURALMUSIC_KEYS=keys.jsonl, and let a proxy speak TLS (docs/keys.md).",
            settings.host,
        )


def worth_a_line(record: logging.LogRecord) -> bool:
    """Whether uvicorn's line is worth one; the application logs requests and streams itself.

    uvicorn takes a handshake that was refused with a response for one that was forgotten,
    shows handshakes with their query, and a client's text that is no UTF-8 with a traceback.
    """
    return not str(record.msg).startswith(
        (
            '%s - "WebSocket ',
            "connection ",
            "ASGI callable returned without completing handshake",
            "Invalid UTF-8 sequence received from client",
        )
    )


def server_config(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """How uvicorn runs the application."""
    logging.getLogger("uvicorn.error").addFilter(worth_a_line)
    # What is wrong with a form is said to its sender; others could fill the log with it.
    logging.getLogger("python_multipart").setLevel(logging.ERROR)
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        log_level=server_log_level(settings),
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=math.ceil(settings.drain_grace_s) + FAREWELL,
        http=Reception(HttpProtocol),  # type: ignore[arg-type]
        ws=StreamProtocol,
        ws_max_size=WS_MAX_SIZE,
        ws_per_message_deflate=False,
        backlog=ACCEPTED_AT_ONCE,
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=[str(each) for each in settings.proxies],
    )
