"""Clients that send what costs more to parse than it says, at full speed beside two robots."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import numpy as np
import pytest
from bench.fleet import Robot, fleet
from bench.served import Served
from faults.requests_by_hand import HANDSHAKE, HEAD, START, send
from websockets.frames import Frame, Opcode

pytestmark = pytest.mark.faults

ROBOTS = 2
FLOOD_S = 5.0
MOST_LAG_MS = 250


def wire(opcode: Opcode, payload: bytes = b"", *, fin: bool = True) -> bytes:
    """A client's frame, again and again."""
    return Frame(opcode, payload, fin=fin).serialize(mask=True) * 2000


CHUNKED = HEAD + b"Content-Type: audio/wav\r\nTransfer-Encoding: chunked\r\n\r\n"
BEGUN = HANDSHAKE + Frame(Opcode.TEXT, b" ", fin=False).serialize(mask=True)
FLOODS = {
    "pings": (HANDSHAKE, wire(Opcode.PING)),
    "pings of 125 bytes, never read": (HANDSHAKE, wire(Opcode.PING, bytes(125))),
    "pongs": (HANDSHAKE, wire(Opcode.PONG)),
    "empty fragments": (BEGUN, wire(Opcode.CONT, fin=False)),
    "fragments of one byte": (BEGUN, wire(Opcode.CONT, b" ", fin=False)),
    "messages": (HANDSHAKE + START, wire(Opcode.TEXT, b'{"type":"ping","id":"1"}')),
    "sample frames one by one": (HANDSHAKE + START, wire(Opcode.BINARY, bytes(8))),
    "chunks of one byte": (CHUNKED, b"1\r\na\r\n" * 2000),
    "headers": (b"GET /livez HTTP/1.1\r\nHost: x\r\n", b"a:\r\n" * 3000),
    "requests": (b"", b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n" * 100),
}
"""What is sent once, and what is sent without a pause from then on"""


async def pour(port: int, first: bytes, flood: bytes) -> float:
    """Send for some seconds, reconnecting; megabytes that the service let through."""
    sent, ends = 0, time.monotonic() + FLOOD_S
    while time.monotonic() < ends:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**10)
        try:
            await send(reader, writer, first)
            async with asyncio.timeout_at(asyncio.get_running_loop().time() + FLOOD_S):
                while time.monotonic() < ends:
                    writer.write(flood)
                    await writer.drain()
                    sent += len(flood)
        except (ConnectionError, TimeoutError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.transport.abort()
    return sent / 2**20


@pytest.mark.parametrize("kind", FLOODS)
def test_flood(figures: Callable[..., None], kind: str) -> None:
    async def scenario(service: Served) -> tuple[list[Robot], float, float]:
        async with fleet(service.url, ROBOTS) as robots:
            began = time.monotonic()
            # In a thread: the robots shall not wait for the attacker's own work.
            sent = await asyncio.to_thread(lambda: asyncio.run(pour(service.port, *FLOODS[kind])))
            return robots, began, sent

    with Served("--stream-workers", "1", "--workers", "1") as service:
        robots, began, sent = asyncio.run(scenario(service))
        assert "Traceback" not in service.log
    lags = [lag for robot in robots for lag in robot.lags_ms(began)]
    lost_s = max(robot.lost_s(began) for robot in robots)
    p99 = np.percentile(lags, 99)
    figures(
        f"A flood of {kind} for {FLOOD_S:g} s, {ROBOTS} robots beside it",
        sent=f"{sent:.0f} MB",
        others=f"{lost_s:.1f} s lost, lag p99 {p99:.0f} ms",
    )
    assert all(robot.cut == 0 for robot in robots)
    assert lost_s == 0
    assert p99 < MOST_LAG_MS
