"""Requests that never end are ended: in the head, in the body, in an answer that is not read."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator

import pytest
from running_service import RunningService
from starlette.types import Message, Receive, Scope, Send

from neuralmusic.errors import RequestTimeout
from service.api.middleware.body_deadline import BodyDeadline
from service.connections import http as connections
from service.settings import Settings

PATIENCE = 20  # seconds until a hanging test fails
SHORT = 0.2
HEAD = b"POST /localize?array=respeaker-usb-4mic-v2 HTTP/1.1\r\nHost: x\r\n"
HANDSHAKE = b"GET /stream HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
BODY = HEAD + b"Content-Type: audio/wav\r\nContent-Length: 100000\r\n\r\n"
REFUSED = BODY.replace(b"audio/wav", b"text/plain")


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(connections, "HEAD_TIMEOUT_S", SHORT)
        running = RunningService(settings=Settings(workers=1, body_timeout_s=SHORT))
        yield running
        running.stop()


def received(connection: socket.socket) -> bytes:
    try:
        return connection.recv(65536)
    except ConnectionResetError:  # it was closed while bytes were on their way
        return b""


def answer(port: int, *said: bytes) -> bytes:
    """What the service answers until it closes the connection."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
        for piece in said:
            connection.sendall(piece)
        return b"".join(iter(lambda: connection.recv(65536), b""))


@pytest.mark.parametrize("head", [HEAD[:1], HEAD], ids=["one byte", "no end"])
def test_a_head_that_does_not_end_is_answered_408(service: RunningService, head: bytes) -> None:
    said = answer(service.port, head)
    assert said.startswith(b"HTTP/1.1 408 ")
    assert b'"code":"request_timeout"' in said


def test_a_connection_that_says_nothing_is_closed_without_a_word(service: RunningService) -> None:
    assert answer(service.port) == b""


@pytest.mark.parametrize("body", [b"", b"RIFF"], ids=["no byte", "some bytes"])
def test_a_body_that_does_not_come_is_answered_408(service: RunningService, body: bytes) -> None:
    said = answer(service.port, BODY, body)
    assert said.startswith(b"HTTP/1.1 408 ")
    assert b"connection: close" in said.lower()
    assert b"500 bytes a second" in said


@pytest.mark.parametrize(
    ("sent", "status"),
    [(HEAD, b"408"), (BODY, b"408"), (HANDSHAKE, b"408"), (REFUSED, b"415")],
    ids=["head", "body", "handshake", "after the answer"],
)
def test_bytes_one_by_one_do_not_help(service: RunningService, sent: bytes, status: bytes) -> None:
    over = threading.Event()

    def drip(connection: socket.socket) -> None:
        try:
            while not over.wait(SHORT / 10):
                connection.sendall(b"x")
        except OSError:  # the service closed the connection
            pass

    with socket.create_connection(("127.0.0.1", service.port), PATIENCE) as connection:
        connection.sendall(sent)
        dripping = threading.Thread(target=drip, args=(connection,))
        dripping.start()
        try:
            said = b"".join(iter(lambda: received(connection), b""))
        finally:
            over.set()
            dripping.join()
    assert said.startswith(b"HTTP/1.1 " + status)


@pytest.mark.parametrize("wrong", [b"Content-Length: 9\r\n", b"Sec-WebSocket-Key: 1\r\n"])
def test_a_handshake_that_is_none_does_not_stay_open(service: RunningService, wrong: bytes) -> None:
    assert answer(service.port, HANDSHAKE, wrong, b"\r\n").startswith(b"HTTP/1.1 400 ")


def test_a_second_request_on_a_connection_has_the_same_deadline(service: RunningService) -> None:
    with socket.create_connection(("127.0.0.1", service.port), PATIENCE) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
        said = b""
        while not said.endswith(b"}"):
            said += connection.recv(65536)
        connection.sendall(b"G")
        assert connection.recv(65536).startswith(b"HTTP/1.1 408 ")


class OwnClock(asyncio.SelectorEventLoop):
    """An event loop whose time the test advances."""

    now = 0.0

    def time(self) -> float:
        return self.now


@pytest.mark.parametrize(("bytes_per_s", "arrives"), [(1000, True), (501, True), (450, False)])
def test_a_body_arrives_where_it_is_fast_enough(bytes_per_s: int, arrives: bool) -> None:
    """A minute of body in pieces, 0.8 of the deadline apart."""
    deadline, step = 5.0, 4.0
    pieces = [bytes(round(step * bytes_per_s))] * 15 + [b""]
    loop = OwnClock()

    async def receive() -> Message:
        await asyncio.sleep(0)
        loop.now += step
        body = pieces.pop(0)
        return {"type": "http.request", "body": body, "more_body": bool(pieces)}

    async def read_all(scope: Scope, receive: Receive, send: Send) -> None:
        while (await receive())["more_body"]:
            pass

    async def send(message: Message) -> None:
        raise AssertionError(message)

    async def request() -> bool:
        try:
            await BodyDeadline(read_all, deadline)({"type": "http"}, receive, send)
        except RequestTimeout:
            return False
        return True

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        assert runner.run(request()) is arrives


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="only Linux has the timer")
def test_accepted_connections_have_the_timer_for_what_is_not_taken() -> None:
    """The system passes the listening socket's option on."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        connections.limit_untaken(listening)
        with (
            socket.create_connection(listening.getsockname()),
            listening.accept()[0] as accepted,
        ):
            set_ms = accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
    assert set_ms == 1000 * connections.UNTAKEN_TIMEOUT_S
