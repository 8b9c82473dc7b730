"""What the tests of the client and of its command share."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvicorn
from scripted_service import TIMEOUT_S, Script, ScriptedService

from service.app import create_app
from service.server import Server
from service.settings import Settings


@pytest.fixture
def service_of() -> Iterator[Callable[..., ScriptedService]]:
    """Start scripted services, which are closed after the test."""
    started: list[ScriptedService] = []

    def start(*scripts: Script, **options: Any) -> ScriptedService:
        started.append(ScriptedService(*scripts, **options))
        return started[-1]

    yield start
    for service in started:
        service.close()


@pytest.fixture
def unused_tcp_port() -> int:
    """A port where nobody listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@pytest.fixture(scope="session")
def real_service() -> Iterator[str]:
    """The address of the service itself, on a free port."""
    app = create_app(Settings(workers=1))
    started, address = threading.Event(), []

    def announce(url: str) -> None:
        address.append(url)
        started.set()

    config = uvicorn.Config(
        app, port=0, log_level="error", ws="websockets-sansio", ws_per_message_deflate=False
    )
    server = Server(config, app.state.service, announce)
    thread = threading.Thread(target=server.run)
    thread.start()
    assert started.wait(TIMEOUT_S)
    yield address[0]
    server.should_exit = True
    thread.join(TIMEOUT_S)
