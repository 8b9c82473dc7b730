"""Clients that never finish a request: 200 at a time, while others are served."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np
import pytest
from bench.fleet import ARRAY, RECORDING, Robot, fleet, until
from bench.requests_by_hand import BODY, HANDSHAKE, HEAD, START, UPGRADE, frame, send
from bench.served import Footprint, Served

pytestmark = pytest.mark.faults

CLIENTS = 200
ROBOTS = 2
BYTE_S = 0.5
"""Seconds between the bytes that keep a connection from being silent"""
BODY_TIMEOUT_S = 5
POOLS = 48
"""Threads that anyio (40) and asyncio keep for files once they were needed"""
ATTACKS = {
    "head": (HEAD, b"x", 10),
    "body": (BODY, b"x", BODY_TIMEOUT_S),
    "handshake": (UPGRADE, b"x", 10),
    "half a frame": (HANDSHAKE + frame(0x82, bytes(8), 4096), b"x", 40),
    "silence": (b"", b"", 10),
}
"""Bytes sent at once, bytes that then drip, and the seconds after which it should be over"""


async def drip(port: int, first: bytes, byte: bytes) -> float:
    """The seconds that the service keeps such a connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    began = time.monotonic()
    try:
        await send(reader, writer, first)
        ended = asyncio.create_task(reader.read(-1))
        while not ended.done():
            writer.write(byte)
            await asyncio.wait([ended], timeout=BYTE_S)
        with contextlib.suppress(ConnectionError):
            await ended
        return time.monotonic() - began
    finally:
        writer.close()


async def ask(http: httpx2.AsyncClient, service: Served) -> httpx2.Response:
    """Localize the sample."""
    with RECORDING.open("rb") as audio:
        return await http.post(
            f"{service.url}/localize", data={"array": ARRAY}, files={"audio": audio}
        )


@pytest.mark.parametrize("kind", ATTACKS)
def test_slow_clients(figures: Callable[..., None], kind: str) -> None:
    first, byte, expected_s = ATTACKS[kind]

    async def scenario(service: Served) -> tuple[list[Robot], float, list[Any]]:
        async with fleet(service.url, ROBOTS) as robots, httpx2.AsyncClient(timeout=30) as http:
            await ask(http, service)  # its worker is there from now on
            await until(lambda: len(service.workers()) == 2, "a worker of each kind runs")
            before = service.footprint()
            began = time.monotonic()
            attack = asyncio.gather(*(drip(service.port, first, byte) for _ in range(CLIENTS)))
            await until(
                lambda: service.footprint().sockets >= before.sockets + CLIENTS / 4, "they connect"
            )
            asked = time.monotonic()
            answer = await ask(http, service)
            answered_s = time.monotonic() - asked
            kept = await asyncio.wait_for(attack, expected_s + 30)
            await http.aclose()
            await until(lambda: service.footprint().sockets <= before.sockets, "sockets are closed")
            return robots, began, [before, service.footprint(), answer, answered_s, kept]

    with Served(
        "--body-timeout-s",
        str(BODY_TIMEOUT_S),
        "--max-sessions",
        "256",
        "--stream-workers",
        "1",
        "--workers",
        "1",
    ) as service:
        robots, began, (before, after, answer, answered_s, kept) = asyncio.run(scenario(service))
        assert "Traceback" not in service.log
    lags = [lag for robot in robots for lag in robot.lags_ms(began)]
    drops = "" if not byte else ", then a byte every half second"
    figures(
        f"{CLIENTS} slow clients ({kind}{drops}), {ROBOTS} robots beside them",
        kept=f"{min(kept):.0f} to {max(kept):.0f} s",
        others=f"a recording answered {answer.status_code} in {answered_s:.1f} s, "
        f"lag of streams p99 {np.percentile(lags, 99):.0f} ms",
        left_over=difference(before, after),
    )
    assert max(kept) < expected_s + 15
    assert answer.status_code == 200
    assert all(robot.cut == 0 for robot in robots)
    assert after.files <= before.files
    assert after.threads <= before.threads + POOLS


def difference(before: Footprint, after: Footprint) -> str:
    """What has grown since before."""
    return (
        f"{after.sockets - before.sockets} sockets, {after.threads - before.threads} threads, "
        f"{after.pss_mb - before.pss_mb:+.1f} MB"
    )


def test_clients_that_never_read(figures: Callable[..., None]) -> None:
    """They hold every place until the system's timer for unread data ends them."""
    places = 8

    async def mute(port: int) -> float:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**10)
        began = time.monotonic()
        try:
            await send(reader, writer, HANDSHAKE + START)
            writer.transport.pause_reading()  # type: ignore[attr-defined]
            while True:
                writer.write(frame(0x82, bytes(4096), 4096))
                async with asyncio.timeout(30):
                    await writer.drain()
                await asyncio.sleep(0.032)
        except (ConnectionError, TimeoutError):
            return time.monotonic() - began
        finally:
            writer.transport.abort()  # type: ignore[attr-defined]

    async def scenario(service: Served) -> tuple[Footprint, Footprint, float]:
        before = service.footprint()
        attack = [asyncio.create_task(mute(service.port)) for _ in range(places)]
        await until(lambda: service.running_sessions() == places, "all places are taken")
        taken = time.monotonic()
        async with fleet(service.url, 1):  # waits for a place
            free_s = time.monotonic() - taken
        for each in attack:
            each.cancel()
        await asyncio.gather(*attack, return_exceptions=True)
        await until(lambda: service.footprint().sockets <= before.sockets, "sockets are closed")
        return before, service.footprint(), free_s

    with Served("--max-sessions", str(places), "--stream-workers", "1") as service:
        before, after, free_s = asyncio.run(scenario(service))
        assert "Traceback" not in service.log
    figures(
        f"{places} clients that never read, as many as there are places",
        free=f"a robot is taken after {free_s:.0f} s",
        left_over=difference(before, after),
    )
