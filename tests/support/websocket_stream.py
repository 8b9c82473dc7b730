"""A stream's conversation by hand, message for message, without the project's client."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
import pytest
import websockets
from running_service import RunningService
from websockets.asyncio.client import ClientConnection, connect

PATIENCE = 30
"""Seconds until a hanging test fails"""
START = {
    "type": "start",
    "audio": {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
    "array": {"name": "respeaker-usb-4mic-v2"},
    "method": "norm_music",
}
SECOND = np.random.default_rng(0).integers(-300, 300, (16000, 4)).astype("<i2").tobytes()


def address(service: RunningService, path: str = "/stream") -> str:
    return service.url.replace("http", "ws") + path


@asynccontextmanager
async def opened(
    service: RunningService, path: str = "/stream", **options: Any
) -> AsyncIterator[ClientConnection]:
    arguments = {"subprotocols": ["doa.v1"], "compression": None, "close_timeout": 1, **options}
    async with asyncio.timeout(PATIENCE), connect(address(service, path), **arguments) as socket:
        yield socket


async def started(socket: ClientConnection, **changes: Any) -> dict[str, Any]:
    await socket.send(json.dumps({**START, **changes}))
    return await until(socket, "ready")


async def until(socket: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of a type."""
    while True:
        message: dict[str, Any] = json.loads(await socket.recv())
        if message["type"] == kind:
            return message


async def end(socket: ClientConnection) -> tuple[dict[str, Any], int | None]:
    """The last message and the close code."""
    last: dict[str, Any] = {}
    with suppress(websockets.ConnectionClosedError):  # any code but 1000
        async for text in socket:
            last = json.loads(text)
    return last, socket.close_code


def refusal(service: RunningService, **options: Any) -> tuple[int, dict[str, Any], Any]:
    """Status, problem and headers of a handshake that is refused."""

    async def attempt() -> tuple[int, dict[str, Any], Any]:
        with pytest.raises(websockets.InvalidStatus) as caught:
            async with opened(service, **options):
                pass
        response = caught.value.response
        return response.status_code, json.loads(response.body or b"{}"), response.headers

    return asyncio.run(attempt())
