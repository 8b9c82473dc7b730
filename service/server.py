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

from neuralmusic.errors import ReloadRefused
from service.api.middleware.hosts import is_loopback
from service.api.state import ServiceState
from service.app import create_app
from service.connections.address import check_address
from service.connections.client_socket import Reception
from service.connections.http import HttpProtocol, limit_untaken
from service.connections.places import Places
from service.connections.websocket import StreamProtocol
from service.lifecycle import Phase
from service.machine.files import file_limit, out_of_files, raise_file_limit
from service.machine.memory import share_one_heap
from service.observability.logs import RareLine, configure_logging, server_log_level
from service.settings import Settings
from service.startup import load_registry

log = logging.getLogger(__name__)

WS_MAX_SIZE = 2**20
"""Most bytes of a WebSocket message: above 256 KiB the stream sends an error, above this only a
close frame follows"""
ACCEPTED_AT_ONCE = 8
"""Most connections accepted between two looks at the streams"""
BACKLOG = 1024
"""Most connections that the system holds until they are accepted"""
FAREWELL = 5
"""Seconds for the last messages of streams, and then for the answers to unfinished recordings"""


class Server(uvicorn.Server):
    """uvicorn that announces its address once it listens, and warns clients before it stops."""

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
        with suppress(NotImplementedError, ValueError, RuntimeError):  # not on every system
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
        """Reload models and keys on SIGHUP, as daemons reload their configuration."""

        async def reload() -> None:
            with suppress(ReloadRefused):  # logged already
                await self._state.reload()

        task = asyncio.get_running_loop().create_task(reload())
        self._reloads.add(task)
        task.add_done_callback(self._reloads.discard)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._wait_for_proxies()
        grace = self._state.settings.drain_grace_s
        lifecycle = self._state.lifecycle
        asyncio.get_running_loop().call_later(grace, lifecycle.enter, Phase.ENDING)
        # uvicorn would close the sockets before the application learns of it.
        self._state.drain()
        with suppress(TimeoutError):
            async with asyncio.timeout(FAREWELL):
                await self._state.streams.empty.wait()
        await super().shutdown(sockets)

    async def _wait_for_proxies(self) -> None:
        """Report not ready, keep accepting: a proxy polls only now and then."""
        state = self._state
        state.lifecycle.enter(Phase.LEAVING)
        began = time.monotonic()
        while time.monotonic() - began < state.settings.drain_delay_s:
            if self.force_exit:  # uvicorn itself polls it, too
                return
            await asyncio.sleep(0.1)


def serve(settings: Settings, announce: Callable[[str], None] | None = None) -> None:
    """Serve until SIGINT or SIGTERM; ``announce`` is called with the address once ready.

    Call it from the main thread: after SIGTERM the process ends with exit code 0.

    Raises
    ------
    BundleError, ConfigError
        If the bundles cannot be loaded, or the port is taken: nothing listens then.
    WorkerLost
        If a worker process does not come up.
    """
    share_one_heap()
    configure_logging(settings)
    raise_file_limit()
    warn_if_open(settings)
    # uvicorn raises a signal again once it has drained, which would look like a failure. The
    # first process of a container ignores SIGTERM until it has a handler.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if sys.platform != "win32":
        # SIGHUP would end the process: block it until there is a handler.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    check_address(settings.host, settings.port)  # before seconds are spent on models
    app = create_app(settings, load_registry(settings))
    Server(server_config(app, settings), app.state.service, announce).run()


def warn_if_open(settings: Settings) -> None:
    """Warn loudly where everybody in the network may do everything."""
    if settings.keys is None and not is_loopback(settings.host):
        log.warning(
            "NO API KEYS: the service listens on %s, and whoever reaches it there may localize, "
            "stream, watch every stream, change noise profiles and reload models. Make a key with "
            "`neuralmusic key new NAME --roles localize,stream --file keys.jsonl`, start with "
            "NEURALMUSIC_KEYS=keys.jsonl, and let a proxy speak TLS (docs/deployment.md).",
            settings.host,
        )


def worth_a_line(record: logging.LogRecord) -> bool:
    """Whether to keep a line of uvicorn's; the application logs requests and streams itself.

    uvicorn reports a handshake refused with a response as forgotten, shows the query of handshakes,
    and logs a traceback for a client's text that is not UTF-8.
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
    """uvicorn's configuration for the application."""
    logging.getLogger("uvicorn.error").addFilter(worth_a_line)
    # Errors of a form go to its sender; in the log they would let anybody fill it.
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
