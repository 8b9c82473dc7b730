"""A stream's socket is read while few messages wait, and no further."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest
import uvicorn
from uvicorn.server import ServerState
from websockets.client import ClientProtocol
from websockets.uri import parse_uri

from neuralmusic.errors import ConfigError
from service.connections import MESSAGES_HELD, StreamProtocol, check_address

MESSAGES = [bytes([number]) for number in range(3 * MESSAGES_HELD)]


class Socket(asyncio.Transport):
    """A transport that remembers whether it is read, and what was written."""

    def __init__(self) -> None:
        super().__init__()
        self.reading = True
        self.pauses = 0
        self.written = b""
        self.closed = False

    def pause_reading(self) -> None:
        self.reading = False
        self.pauses += 1

    def resume_reading(self) -> None:
        self.reading = True

    def write(self, data: Any) -> None:
        self.written += data

    def close(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return False


def opened(application: Any) -> tuple[StreamProtocol, Socket, ClientProtocol]:
    """A connection in the running loop, and the client at its other end."""
    config = uvicorn.Config(application, ws=StreamProtocol, lifespan="off", log_config=None)
    config.load()
    client, transport = ClientProtocol(parse_uri("ws://robot/")), Socket()
    protocol = StreamProtocol(config, ServerState(), {}, asyncio.get_running_loop())
    protocol.connection_made(transport)
    client.send_request(client.connect())
    protocol.data_received(b"".join(client.data_to_send()))
    return protocol, transport, client


async def conversation(held: bool) -> tuple[Socket, list[bytes], list[bool]]:
    """What the application received of ``MESSAGES``, and whether each found the socket read."""
    accepted, may_read, received = asyncio.Event(), asyncio.Event(), list[bytes]()
    if not held:
        may_read.set()

    async def application(_scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        accepted.set()
        await may_read.wait()
        for _ in MESSAGES:
            received.append((await receive())["bytes"])

    protocol, transport, client = opened(application)
    (task,) = protocol.tasks
    await accepted.wait()
    client.receive_data(transport.written)
    found = []
    for message in MESSAGES:
        found.append(transport.reading)
        client.send_binary(message)
        protocol.data_received(b"".join(client.data_to_send()))
        for _ in range(0 if held else 3):  # the application's turns
            await asyncio.sleep(0)
    may_read.set()
    await task
    protocol.connection_lost(None)
    return transport, received, found


def test_an_application_that_keeps_up_is_never_paused_for() -> None:
    transport, received, _ = asyncio.run(conversation(held=False))
    assert received == MESSAGES
    assert transport.pauses == 0


def test_what_is_not_taken_stays_in_the_socket_and_then_comes_whole() -> None:
    transport, received, found = asyncio.run(conversation(held=True))
    assert found == [True] * MESSAGES_HELD + [False] * (len(MESSAGES) - MESSAGES_HELD)
    assert received == MESSAGES
    assert transport.pauses == 1
    assert transport.reading


async def cut_off_after_a_ping(*, says: bool, held_back: bool) -> bool:
    """Whether a client is cut off that answers no ping, but may say something or be held back."""
    over = asyncio.Event()

    async def application(_scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        accepted.set()
        await over.wait()

    accepted = asyncio.Event()
    protocol, transport, client = opened(application)
    (task,) = protocol.tasks
    await accepted.wait()
    client.receive_data(transport.written)
    protocol.stop_keepalive()
    for message in MESSAGES if held_back else ():
        client.send_binary(message)
    protocol.data_received(b"".join(client.data_to_send()))
    protocol.ping_sent_at = asyncio.get_running_loop().time()
    if says:
        client.send_binary(b"audio")
        while asyncio.get_running_loop().time() <= protocol.ping_sent_at:
            pass  # the clock's resolution
        protocol.data_received(b"".join(client.data_to_send()))
    protocol.keepalive_timeout()
    closed = transport.closed
    protocol.stop_keepalive()
    over.set()
    await task
    protocol.connection_lost(None)
    return closed


def test_only_a_client_that_is_read_and_says_nothing_is_cut_off_for_its_pong() -> None:
    assert asyncio.run(cut_off_after_a_ping(says=False, held_back=False))
    assert not asyncio.run(cut_off_after_a_ping(says=True, held_back=False))
    assert not asyncio.run(cut_off_after_a_ping(says=False, held_back=True))


async def closed_by_shutdown(*, answers: bool) -> bool:
    """Whether a connection that is being closed goes when the service ends, answered or not."""

    async def application(_scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.close", "code": 1012})

    protocol, transport, client = opened(application)
    (task,) = protocol.tasks
    await task
    protocol.shutdown()
    if answers:
        client.receive_data(transport.written)
        protocol.data_received(b"".join(client.data_to_send()))
    closed = transport.closed
    protocol.connection_lost(None)
    return closed


def test_the_service_s_end_waits_for_the_answer_to_a_close() -> None:
    """Closing the socket with unread audio would discard the last messages."""
    assert not asyncio.run(closed_by_shutdown(answers=False))
    assert asyncio.run(closed_by_shutdown(answers=True))


def test_a_taken_port_is_known_before_anything_is_loaded() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1 .*--port"):
            check_address("127.0.0.1", port)
    check_address("127.0.0.1", port)
    check_address("localhost", 0)
    with pytest.raises(ConfigError, match=r"host nowhere\.invalid"):
        check_address("nowhere.invalid", port)
