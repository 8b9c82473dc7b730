"""Clients that misbehave one after the other against a running service, and what they leave behind.

``python tests/bench/hostile.py --pid PID`` prints the memory of the service and its workers, its
threads and its open files before and after: 2,000 who connect and vanish, 10,000 tiny messages,
500 who start and say nothing.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import httpx2
import websockets
from robots import OPTIONS, start
from websockets.asyncio.client import connect


async def vanish(url: str, count: int = 2000) -> None:
    """Connect, start, send a little and vanish."""
    for index in range(count):
        with suppress(websockets.InvalidStatus):  # full for a moment
            async with connect(url, **OPTIONS) as socket:
                if index % 2:
                    await socket.send(start(100))
                    await socket.send(bytes(6400))
                socket.transport.abort()


async def tiny(url: str, count: int = 10_000) -> None:
    """One sample frame a message."""
    async with connect(url, **OPTIONS) as socket:
        await socket.send(start(100))
        for _ in range(count):
            await socket.send(bytes(8))
        await socket.send('{"type":"stop"}')
        async for text in socket:
            message = json.loads(text)
        assert message["type"] == "closing"


async def silent(url: str, count: int = 500) -> None:
    """Start and say nothing, until refused."""
    held = []
    refused = 0
    for _ in range(count):
        try:
            socket = await connect(url, **OPTIONS)
        except websockets.InvalidStatus:
            refused += 1
            continue
        await socket.send(start(100))
        held.append(socket)
    print(f"  {len(held)} were taken, {refused} refused with 503")
    for socket in held:
        socket.transport.abort()


def processes(pid: int) -> list[int]:
    """The service and its workers."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *map(int, children)]


def footprint(pid: int) -> str:
    memory = []
    for each in processes(pid):
        status = Path(f"/proc/{each}/status").read_text()
        memory.append(f"{int(status.split('VmRSS:')[1].split()[0]) / 1024:.0f}")
    threads = len(list(Path(f"/proc/{pid}/task").iterdir()))
    files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return f"memory {' + '.join(memory)} MB, {threads} threads, {files} files"


def settle(url: str) -> None:
    """Wait until no session runs."""
    http = url.replace("ws", "http", 1).replace("/stream", "/sessions")
    while any(each["state"] == "running" for each in httpx2.get(http).json()["sessions"]):
        time.sleep(0.1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:8000/stream")
    parser.add_argument("--pid", type=int, required=True, help="of the service")
    arguments = parser.parse_args()
    print("at rest:", footprint(arguments.pid))
    attacks: tuple[Callable[[str], Awaitable[None]], ...] = (vanish, vanish, tiny, silent)
    for attack in attacks:
        began = time.monotonic()
        asyncio.run(attack(arguments.url))  # type: ignore[arg-type]
        settle(arguments.url)
        spent = time.monotonic() - began
        print(f"after {attack.__name__} ({spent:.1f} s): {footprint(arguments.pid)}")


if __name__ == "__main__":
    main()
