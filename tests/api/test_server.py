"""The server itself, over a socket: announced, patient with large uploads, stopped cleanly."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Iterator
from unittest.mock import patch
from urllib.parse import urlsplit

import httpx2
import pytest
import uvicorn
from running_service import workers_with_the_first_work

from service.api.state import ServiceState
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.server import Server
from service.settings import Settings

PATIENCE = 20  # seconds until a hanging test fails
LIMIT = 2**20


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A server on a free port, as it announces itself."""
    app = create_app(Settings(max_upload_bytes=LIMIT), BundleRegistry(()))
    config = uvicorn.Config(app, port=0, log_level="critical", ws="none")
    announced: queue.Queue[str] = queue.Queue()
    server = Server(config, app.state.service, announced.put)
    thread = threading.Thread(target=server.run)
    with patch.object(ServiceState, "start_workers", workers_with_the_first_work):
        thread.start()
        url = announced.get(timeout=PATIENCE)
    yield url
    server.should_exit = True
    thread.join(PATIENCE)
    assert not thread.is_alive()


def test_it_is_ready_when_it_announces_itself(address: str) -> None:
    assert httpx2.get(f"{address}/readyz").json() == {"status": "ok"}


@pytest.mark.parametrize("declared", [True, False], ids=["declared", "chunked"])
def test_a_client_that_sends_too_much_can_read_why(address: str, declared: bool) -> None:
    body = bytes(8 * LIMIT)
    content = body if declared else (body[i : i + LIMIT] for i in range(0, len(body), LIMIT))
    response = httpx2.post(
        f"{address}/localize", content=content, headers={"Content-Type": "audio/wav"}
    )
    assert response.status_code == 413
    assert response.json()["code"] == "upload_too_large"


@pytest.mark.parametrize(
    ("length", "answer"), [(LIMIT, b"HTTP/1.1 100 "), (LIMIT + 1, b"HTTP/1.1 413 ")]
)
def test_a_client_that_asks_first_is_told_before_it_sends(
    address: str, length: int, answer: bytes
) -> None:
    url = urlsplit(address)
    request = (
        "POST /localize HTTP/1.1\r\nHost: x\r\nContent-Type: audio/wav\r\n"
        f"Content-Length: {length}\r\nExpect: 100-continue\r\n\r\n"
    )
    with socket.create_connection((url.hostname, url.port), PATIENCE) as connection:
        connection.sendall(request.encode())
        assert connection.recv(4096).startswith(answer)
