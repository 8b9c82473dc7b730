"""Addresses at which no service answers: the client says what to look at."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Callable, Iterator

import pytest

from neuralmusic import LocalizationClient, ServiceUnreachable, StreamClient

AUDIO = {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4}
ARRAY = "respeaker-usb-4mic-v2"


def localize(url: str) -> None:
    with LocalizationClient(url) as client:
        client.arrays()


def stream(url: str) -> None:
    with StreamClient(url, array=ARRAY, audio=AUDIO, reconnect=False):
        pass


class Plain(socketserver.BaseRequestHandler):
    """An HTTP server that takes every request for a bad one."""

    def handle(self) -> None:
        self.request.recv(1024)
        self.request.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")


@pytest.fixture
def plain_port() -> Iterator[int]:
    with socketserver.TCPServer(("127.0.0.1", 0), Plain) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("call", [localize, stream])
def test_a_service_without_tls_is_no_absent_one(
    call: Callable[[str], None], plain_port: int
) -> None:
    with pytest.raises(ServiceUnreachable, match="not with TLS: use http:// or ws://"):
        call(f"https://127.0.0.1:{plain_port}")


@pytest.mark.parametrize("call", [localize, stream])
def test_a_service_that_may_listen_on_loopback_alone_is_hinted_at(
    call: Callable[[str], None],
) -> None:
    with pytest.raises(ServiceUnreachable, match=r"NEURALMUSIC_HOST=0\.0\.0\.0"):
        call("http://no-such-host.invalid:8000")
    with pytest.raises(ServiceUnreachable, match=r"running there \(neuralmusic serve\)"):
        call("http://127.0.0.1:9")
