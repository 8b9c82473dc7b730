"""Requests as bytes, for clients that stop in their midst."""

from __future__ import annotations

import asyncio

from bench.robots import start

HEAD = b"POST /localize?array=respeaker-usb-4mic-v2 HTTP/1.1\r\nHost: x\r\n"
BODY = HEAD + b"Content-Type: audio/wav\r\nContent-Length: 100000\r\n\r\n"
UPGRADE = b"GET /stream HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
HANDSHAKE = UPGRADE + (
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: doa.v1\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


def frame(opcode: int, payload: bytes, length: int) -> bytes:
    """A client's frame with a mask of zeros; half of one where the length is greater."""
    return bytes((opcode, 0x80 | 126)) + length.to_bytes(2, "big") + bytes(4) + payload


STARTED = start(20).replace('"interval_ms": 20', '"interval_ms": 20, "include": ["spectrum"]')
START = frame(0x81, STARTED.encode(), len(STARTED))


async def send(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, said: bytes) -> None:
    """Send what begins with a request; what follows a handshake waits for its answer."""
    if said.startswith(HANDSHAKE):
        writer.write(HANDSHAKE)
        await reader.readuntil(b"\r\n\r\n")
        said = said.removeprefix(HANDSHAKE)
    writer.write(said)
    await writer.drain()
