"""Refusals arrive, also at clients that are still sending; requests with two ends are refused."""

from __future__ import annotations

import asyncio
import io
import select
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from running_service import RunningService

from service.connections import client_socket, http
from service.connections.client_socket import ClientSocket
from service.connections.places import Places
from service.settings import Settings

PATIENCE = 20  # seconds until a hanging test fails
MOST = 2**20
SHORT_S = 0.02
HEAD = (
    b"POST /localize?array=respeaker-usb-4mic-v2 HTTP/1.1\r\nHost: x\r\nContent-Type: audio/wav\r\n"
)
SMUGGLED = b"GET /smuggled HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    running = RunningService(settings=Settings(workers=1, max_upload_bytes=MOST))
    yield running
    running.stop()


def answer(port: int, said: bytes) -> bytes:
    """What the service answers to a client that sends all before it reads."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
        connection.sendall(said)
        return b"".join(iter(lambda: connection.recv(65536), b""))


@pytest.mark.parametrize("version", [b"1.1", b"1.0"])
def test_a_refusal_reaches_who_sends_all_of_a_large_body(
    service: RunningService, version: bytes
) -> None:
    """More than the system holds on its way, so that the client sends on after it was refused."""
    body = bytes(32 * MOST)
    head = HEAD.replace(b"1.1", version) + b"Connection: close\r\nContent-Length: %d\r\n\r\n"
    said = answer(service.port, head % len(body) + body)
    assert said.startswith(b"HTTP/1.1 413 ")
    assert said.endswith(b'"code":"upload_too_large"}')


@pytest.mark.parametrize(
    ("head", "status"),
    [
        (HEAD, b"503"),
        (HEAD.replace(b"audio/wav", b"text/plain"), b"503"),
        (HEAD.replace(b"Host: x", b"Host: x\r\nOrigin: http://evil.example"), b"403"),
        (HEAD.replace(b"/localize?", b"/nowhere?"), b"404"),
    ],
)
def test_so_does_every_other_one(
    service: RunningService, monkeypatch: pytest.MonkeyPatch, head: bytes, status: bytes
) -> None:
    monkeypatch.setattr(service.state.recording_workers, "admitted", 1000)
    with socket.create_connection(("127.0.0.1", service.port), PATIENCE) as connection:
        connection.sendall(head + b"Connection: close\r\nContent-Length: %d\r\n\r\n" % MOST)
        for _ in range(16):  # slowly enough to be refused before the end
            connection.sendall(bytes(MOST // 16))
            select.select([connection], [], [], SHORT_S)
        said = b"".join(iter(lambda: connection.recv(65536), b""))
    assert said.startswith(b"HTTP/1.1 " + status)
    assert said.endswith(b"}")


def test_a_request_with_a_length_and_chunks_is_refused_and_nothing_behind_it_is_read(
    service: RunningService,
) -> None:
    both = b"Content-Length: %d\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" % (
        5 + len(SMUGGLED)
    )
    said = answer(service.port, HEAD + both + SMUGGLED)
    assert said.startswith(b"HTTP/1.1 400 ")
    assert b"both Content-Length and Transfer-Encoding" in said
    assert said.count(b"HTTP/1.1") == 1


@pytest.mark.parametrize("media_type", [b"audio/wav", b"text/plain"])
def test_a_body_that_cannot_be_read_is_answered_once(
    service: RunningService, written_log: io.StringIO, media_type: bytes
) -> None:
    """Also where the application, which read none of it, was about to answer."""
    head = HEAD.replace(b"audio/wav", media_type) + b"Transfer-Encoding: chunked\r\n\r\n"
    said = answer(service.port, head + b"5\r\nabcde\r\nzz\r\n")
    assert said.startswith(b"HTTP/1.1 400 ")
    assert said.count(b"HTTP/1.1") == 1
    answer(service.port, b"GET /livez HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    assert "Exception" not in written_log.getvalue()


@pytest.mark.parametrize(
    "said",
    [HEAD + b"a:\r\n" * http.HEAD_BYTES, HEAD + b"Transfer-Encoding: chunked\r\n\r\nx\r\n"],
    ids=["head", "chunk"],
)
def test_what_is_no_request_is_told_why(service: RunningService, said: bytes) -> None:
    got = answer(service.port, said + bytes(16 * MOST))
    assert got.startswith(b"HTTP/1.1 400 ")
    assert b'"code":"upload_invalid"' in got


class Socket(asyncio.Transport):
    """A transport that remembers how it was closed."""

    def __init__(self) -> None:
        super().__init__()
        self.half_closed = self.closed = False
        self.reading = True

    def write_eof(self) -> None:
        self.half_closed = True

    def close(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return self.closed

    def resume_reading(self) -> None:
        self.reading = True

    def pause_reading(self) -> None:
        self.reading = False


class Refusing(asyncio.Protocol):
    """A protocol in the midst of whose request the connection is closed."""

    idle = False
    lost = False

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost = True

    def expects_more(self) -> bool:
        return True


def test_a_closed_connection_is_read_for_a_bounded_time_and_rate() -> None:
    class OwnClock(asyncio.SelectorEventLoop):
        now = 0.0

        def time(self) -> float:
            return self.now

    loop = OwnClock()

    async def closed(sent: list[int]) -> tuple[float, Socket, Refusing]:
        """How long a connection stays open whose client sends so many bytes each second."""
        transport, spoken = Socket(), Refusing()
        connection = ClientSocket(spoken, Places(8, 8))
        connection.connection_made(transport)
        connection.close()
        began = loop.now
        for count in sent:
            loop.now += 1.0
            for _ in range(3):
                await asyncio.sleep(0)
            if transport.closed:
                break
            connection.data_received(bytes(count))
        seconds = loop.now - began
        connection.connection_lost(None)
        return seconds, transport, spoken

    def run(sent: list[int]) -> Any:
        return runner.run(closed(sent))

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        seconds, transport, spoken = run([0] * 99)
        assert transport.half_closed
        assert spoken.lost  # while the client may still read
        assert seconds <= 2 * client_socket.QUIET_S
        assert run([1] * 99)[0] <= client_socket.LINGER_S + client_socket.QUIET_S
        transport = run([client_socket.LINGER_BYTES_PER_S])[1]
        assert not transport.reading
