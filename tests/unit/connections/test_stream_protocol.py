"""A stream's socket is read while few messages wait, and no faster than is allowed."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
import uvicorn
from websockets.client import ClientProtocol
from websockets.frames import Frame, Opcode
from websockets.uri import parse_uri

from service.api.stream import FLOOD
from service.connections.client_socket import PIECE_BYTES, ClientSocket
from service.connections.places import Places
from service.connections.websocket import MESSAGES_HELD, StreamProtocol

MESSAGES = [bytes([number]) for number in range(3 * MESSAGES_HELD)]


class Socket(asyncio.Transport):
    """A transport that remembers whether it is read, and what was written."""

    def __init__(self) -> None:
        super().__init__()
        self.reading = True
        self.pauses = 0
        self.written = b""
        self.closed = False
        self.client_socket: ClientSocket
        """Gets what the client sends"""

    def pause_reading(self) -> None:
        self.pauses += self.reading
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def write(self, data: Any) -> None:
        self.written += data

    def close(self) -> None:
        self.closed = True

    def write_eof(self) -> None:
        self.closed = True  # the client reads to the end, and what it sends is thrown away

    def abort(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return False


def opened(application: Any) -> tuple[StreamProtocol, Socket, ClientProtocol]:
    """A connection in the running loop, and the client at its other end."""
    config = uvicorn.Config(application, ws=StreamProtocol, lifespan="off", log_config=None)
    config.load()
    client, transport = ClientProtocol(parse_uri("ws://robot/")), Socket()
    places = Places(8, 8)
    protocol = StreamProtocol(config, places, {}, asyncio.get_running_loop())
    transport.client_socket = ClientSocket(protocol, places)
    transport.client_socket.connection_made(transport)
    client.send_request(client.connect())
    transport.client_socket.data_received(b"".join(client.data_to_send()))
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
        transport.client_socket.data_received(b"".join(client.data_to_send()))
        for _ in range(0 if held else 3):  # the application's turns
            await asyncio.sleep(0)
    may_read.set()
    await task
    transport.client_socket.connection_lost(None)
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
    transport.client_socket.data_received(b"".join(client.data_to_send()))
    protocol.ping_sent_at = asyncio.get_running_loop().time()
    if says:
        client.send_binary(b"audio")
        while asyncio.get_running_loop().time() <= protocol.ping_sent_at:
            pass  # the clock's resolution
        transport.client_socket.data_received(b"".join(client.data_to_send()))
    protocol.keepalive_timeout()
    closed = transport.closed
    protocol.stop_keepalive()
    over.set()
    await task
    transport.client_socket.connection_lost(None)
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
        transport.client_socket.data_received(b"".join(client.data_to_send()))
    closed = transport.closed
    transport.client_socket.connection_lost(None)
    return closed


def test_the_service_s_end_waits_for_the_answer_to_a_close() -> None:
    """Closing the socket with unread audio would discard the last messages."""
    assert not asyncio.run(closed_by_shutdown(answers=False))
    assert asyncio.run(closed_by_shutdown(answers=True))


FLOODS = {
    "pings": Frame(Opcode.PING, b""),
    "pongs": Frame(Opcode.PONG, b""),
    "fragments": Frame(Opcode.CONT, b"a", fin=False),
    "empty fragments": Frame(Opcode.CONT, b"", fin=False),
    "messages": Frame(Opcode.BINARY, b"a"),
}


async def flooded(flood: Frame) -> tuple[int, bool, int]:
    """How many of many frames were parsed at once, whether more are read, and how often the
    application was told."""

    async def application(_scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        accepted.set()
        while (message := await receive())["type"] != "websocket.disconnect":
            told.append(FLOOD in message)

    accepted, told = asyncio.Event(), list[bool]()
    protocol, transport, client = opened(application)
    (task,) = protocol.tasks
    await accepted.wait()
    client.receive_data(transport.written)
    parsed = 0

    def counting(piece: bytes) -> None:
        nonlocal parsed
        parsed += len(piece) // len(wire)
        parse(piece)

    parse, protocol.conn.receive_data = protocol.conn.receive_data, counting  # type: ignore[method-assign]
    wire = flood.serialize(mask=True)
    first = Frame(Opcode.TEXT, b"a", fin=False).serialize(mask=True)
    opening = first if flood.opcode is Opcode.CONT else b""
    transport.client_socket.data_received(opening + 20_000 * wire)
    for _ in range(10 * MESSAGES_HELD):  # the application's turns
        await asyncio.sleep(0)
    transport.client_socket.connection_lost(None)
    await task
    return parsed, transport.reading, sum(told)


@pytest.mark.parametrize("flood", FLOODS)
def test_no_flood_is_parsed_at_once(flood: str) -> None:
    parsed, reading, told = asyncio.run(flooded(FLOODS[flood]))
    assert parsed <= 2 * Places.stream_frames_per_s + PIECE_BYTES
    assert not reading
    assert told == (flood != "messages")
