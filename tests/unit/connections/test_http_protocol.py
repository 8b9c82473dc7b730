"""Requests that come while another one of their connection is being answered."""

from __future__ import annotations

import asyncio
from typing import Any

import uvicorn

from service.connections.client_socket import PIECE_BYTES, ClientSocket
from service.connections.http import HEAD_BYTES, HttpProtocol
from service.connections.places import Places

GET = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"
LOOKS = 3 * HEAD_BYTES // PIECE_BYTES
"""How often the application looks whether its client is still there"""


class Socket(asyncio.Transport):
    """A transport at whose other end a client sends as soon as it is read."""

    def __init__(self) -> None:
        super().__init__()
        self.reading = True
        self.written = b""
        self.half_closed = False

    def pause_reading(self) -> None:
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def write(self, data: Any) -> None:
        self.written += data

    def write_eof(self) -> None:
        self.half_closed = True

    def is_closing(self) -> bool:
        return False


async def answered(behind: bytes) -> tuple[Socket, int]:
    """A request with others behind it; the most bytes of those that were read ahead."""
    ahead: list[int] = []

    async def application(_scope: Any, receive: Any, send: Any) -> None:
        while (await receive())["more_body"]:
            pass
        for _ in range(LOOKS if not ahead else 0):
            looking = asyncio.ensure_future(receive())
            await asyncio.sleep(0)
            if transport.reading:
                connection.data_received(behind)
            await asyncio.sleep(0)
            looking.cancel()
            ahead.append(len(protocol.conn.trailing_data[0]))
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body"})

    config = uvicorn.Config(application, http=HttpProtocol, lifespan="off", log_config=None)
    config.load()
    places, transport = Places(8, 8), Socket()
    protocol = HttpProtocol(config, places, {}, asyncio.get_running_loop())
    connection = ClientSocket(protocol, places)
    connection.connection_made(transport)
    connection.data_received(GET)
    while protocol.tasks:
        await asyncio.gather(*protocol.tasks)
    connection.connection_lost(None)
    return transport, max(ahead)


def test_a_few_are_answered_one_after_the_other() -> None:
    transport, _ = asyncio.run(answered(GET))
    assert transport.written.count(b"HTTP/1.1 204 ") == 1 + LOOKS
    assert not transport.half_closed


def test_of_a_flood_little_is_kept_and_its_connection_ends_with_the_answer() -> None:
    transport, ahead = asyncio.run(answered(GET * (HEAD_BYTES // len(GET))))
    assert transport.written.count(b"HTTP/1.1 204 ") == 1
    assert transport.half_closed
    assert ahead <= HEAD_BYTES + PIECE_BYTES
