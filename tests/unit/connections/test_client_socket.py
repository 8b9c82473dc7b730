"""What many clients send at once is parsed in turns."""

from __future__ import annotations

import asyncio
from unittest.mock import Mock

from service.connections.client_socket import PIECE_BYTES, TURN_BYTES, ClientSocket
from service.connections.places import Places

SENT = bytes(16 * TURN_BYTES)


class Spoken(asyncio.Protocol):
    """A protocol that notes what it parses, and never has enough."""

    def __init__(self, name: str, parsed: list[tuple[str, int]]) -> None:
        self._name, self._parsed = name, parsed

    def data_received(self, data: bytes) -> None:
        self._parsed.append((self._name, len(data)))

    def wait_s(self) -> float:
        return 0.0


async def parsed(*names: str) -> tuple[list[tuple[str, int]], list[Mock]]:
    """What is parsed in which order where clients have sent a megabyte each, and their sockets."""
    pieces: list[tuple[str, int]] = []
    sockets = [Mock(asyncio.Transport) for _ in names]
    for name, socket in zip(names, sockets, strict=True):
        connection = ClientSocket(Spoken(name, pieces), Places(8, 8))
        connection.connection_made(socket)
        connection.data_received(SENT)
        assert socket.pause_reading.called
        assert not socket.resume_reading.called
    for _ in range(len(SENT) // TURN_BYTES):
        await asyncio.sleep(0)
    assert sum(size for _, size in pieces) == len(names) * len(SENT)
    return pieces, sockets


def test_a_client_that_sends_much_lets_others_have_their_turn() -> None:
    pieces, sockets = asyncio.run(parsed("a", "b", "c"))
    turn = TURN_BYTES // PIECE_BYTES
    assert [name for name, _ in pieces[: 6 * turn]] == 2 * (
        ["a"] * turn + ["b"] * turn + ["c"] * turn
    )
    assert {size for _, size in pieces} == {PIECE_BYTES}
    assert all(socket.resume_reading.call_count == 1 for socket in sockets)
