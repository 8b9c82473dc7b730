"""Requests as bytes, for clients that stop in their midst or never do."""

from __future__ import annotations

import asyncio
import json
import time

from websockets.frames import Frame, Opcode

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


STARTED = json.dumps(
    {
        "type": "start",
        "audio": {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4},
        "array": {"name": "respeaker-usb-4mic-v2"},
        "output": {"interval_ms": 20, "include": ["spectrum"]},
    }
)
START = frame(0x81, STARTED.encode(), len(STARTED))


def wire(opcode: Opcode, payload: bytes = b"", *, fin: bool = True) -> bytes:
    """A client's frame, again and again."""
    return Frame(opcode, payload, fin=fin).serialize(mask=True) * 2000


CHUNKED = HEAD + b"Content-Type: audio/wav\r\nTransfer-Encoding: chunked\r\n\r\n"
BEGUN = HANDSHAKE + Frame(Opcode.TEXT, b" ", fin=False).serialize(mask=True)


async def send(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, said: bytes) -> None:
    """Send what begins with a request; what follows a handshake waits for its answer."""
    if said.startswith(HANDSHAKE):
        writer.write(HANDSHAKE)
        await reader.readuntil(b"\r\n\r\n")
        said = said.removeprefix(HANDSHAKE)
    writer.write(said)
    await writer.drain()


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


async def pour(port: int, first: bytes, flood: bytes, seconds: float) -> float:
    """Send for some seconds, reconnecting; megabytes that the service let through."""
    sent, ends = 0, time.monotonic() + seconds
    while time.monotonic() < ends:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**10)
        try:
            await send(reader, writer, first)
            async with asyncio.timeout_at(asyncio.get_running_loop().time() + seconds):
                while time.monotonic() < ends:
                    writer.write(flood)
                    await writer.drain()
                    sent += len(flood)
        except (ConnectionError, TimeoutError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.transport.abort()
    return sent / 2**20
