"""2,000 clients that connect and vanish, at every stage of a connection."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable

import pytest
from bench.fleet import fleet, until
from bench.requests_by_hand import BODY, HANDSHAKE, START, UPGRADE, frame, send
from bench.served import Footprint, Served

pytestmark = pytest.mark.faults

EACH = 500
AT_ONCE = 20
POOLS = 48
"""Threads that anyio (40) and asyncio keep for files once they were needed"""
RESET = struct.pack("ii", 1, 0)
"""``SO_LINGER`` that makes a close a reset"""

STAGES = {
    "connected": b"",
    "half a handshake, reset": UPGRADE,
    "stream accepted and started, reset": HANDSHAKE + START + frame(0x82, bytes(2048), 2048),
    "half an upload, reset": BODY + bytes(4096),
}


def test_clients_that_vanish(figures: Callable[..., None]) -> None:
    async def vanish(port: int, said: bytes, turns: asyncio.Semaphore) -> None:
        async with turns:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            await send(reader, writer, said)
            if said:
                connection = writer.get_extra_info("socket")
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                writer.transport.abort()
            writer.close()

    async def attack(service: Served) -> None:
        turns = asyncio.Semaphore(AT_ONCE)
        await asyncio.gather(
            *(vanish(service.port, said, turns) for _ in range(EACH) for said in STAGES.values())
        )
        await until(lambda: service.running_sessions() == 0, "no session is left over")

    async def scenario(service: Served) -> tuple[Footprint, Footprint, Footprint]:
        async with fleet(service.url, 2):
            pass  # what everybody needs once is there
        await until(lambda: service.running_sessions() == 0, "the robots are gone")
        before = service.footprint()
        await attack(service)
        await until(lambda: service.footprint().sockets <= before.sockets, "sockets are closed")
        once = service.footprint()
        await attack(service)
        await until(lambda: service.footprint().sockets <= before.sockets, "sockets are closed")
        return before, once, service.footprint()

    with Served("--stream-workers", "1") as service:
        before, once, twice = asyncio.run(scenario(service))
        log = service.log
    figures(
        f"{EACH * len(STAGES):,} clients that connect and vanish ({', '.join(STAGES)}), "
        "then as many again",
        memory=f"{before.pss_mb:.0f} MB, then {once.pss_mb:.0f} MB, then {twice.pss_mb:.0f} MB",
        threads=f"{before.threads}, {once.threads}, {twice.threads}",
        files=f"{before.files}, {once.files}, {twice.files}",
        sessions="0 after each",
    )
    assert "Traceback" not in log, log[-2000:]
    assert twice.files <= before.files
    assert twice.threads <= before.threads + POOLS
    assert twice.pss_mb - once.pss_mb < 20
