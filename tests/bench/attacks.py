"""Clients that misbehave for a second or two, for the soak; each attack has one address.

None may bring the service out of its protocol: what it answers is checked where it answers.
"""

from __future__ import annotations

import asyncio
import json
import random
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import httpx2
import numpy as np
from requests_by_hand import (
    BODY,
    FLOODS,
    HANDSHAKE,
    HEAD,
    START,
    UPGRADE,
    frame,
    pour,
    send,
)
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.whitening import learn_noise
from service.inference.noise_profile import noise_bytes

ARRAY = "respeaker-usb-4mic-v2"
RECORDING = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
SECONDS = 1.5
CROWD = 200
UPLOADS = 30
DRIPPING = 20
MARKUP = """"'><img src=x onerror=alert(1)>"""
I64 = (-(2**63), 2**63 - 1)

Attack = Callable[[int, random.Random], Awaitable[None]]
"""Takes the service's port, and where its choices come from"""


async def flood(port: int, choice: random.Random) -> None:
    """Frames, headers or requests as fast as they are taken."""
    await pour(port, *FLOODS[choice.choice(sorted(FLOODS))], SECONDS)


async def idle_crowd(port: int, choice: random.Random) -> None:
    """Connections that say nothing."""
    opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(CROWD)]
    await asyncio.sleep(SECONDS)
    for _, writer in opened:
        writer.transport.abort()


async def slow_drips(port: int, choice: random.Random) -> None:
    """Requests, uploads, handshakes and frames that come byte by byte and then no more."""

    async def drip(first: bytes) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        with suppress(ConnectionError):
            await send(reader, writer, first)
            for _ in range(5):
                writer.write(b"x")
                await asyncio.sleep(SECONDS / 5)
        writer.transport.abort()

    kinds = (HEAD, BODY, UPGRADE, HANDSHAKE + START + frame(0x82, bytes(8), 2048))
    await asyncio.gather(*(drip(choice.choice(kinds)) for _ in range(DRIPPING)))


async def never_reads(port: int, choice: random.Random) -> None:
    """A stream that sends audio faster than real time and takes no result."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**10)
    with suppress(ConnectionError, TimeoutError, asyncio.IncompleteReadError):
        await send(reader, writer, HANDSHAKE + START)
        async with asyncio.timeout(SECONDS):
            while True:
                writer.write(frame(0x82, bytes(6400), 6400))
                await writer.drain()
                await asyncio.sleep(0.02)
    writer.transport.abort()


async def lying_stream(port: int, choice: random.Random) -> None:
    """Samples that are none, sequence numbers that jump, capture times at both ends."""
    audio = {"encoding": "pcm_f32le", "sample_rate": 16_000, "channels": 4, "header": "seq_time"}
    noise = np.random.default_rng(choice.randrange(2**32)).normal(0, 0.1, (800, 4)).astype("<f4")
    noise[choice.randrange(800)] = (np.nan, np.inf, -np.inf, 3e38)
    array = {"name": MARKUP, "positions_m": preset(ARRAY).positions.tolist()}
    with suppress(ConnectionClosed):
        async with connect(f"ws://127.0.0.1:{port}/stream", subprotocols=["doa.v1"]) as stream:
            await stream.send(json.dumps({"type": "start", "audio": audio, "array": array}))
            for _ in range(30):
                sequence = choice.choice((0, 1, 2**31, 2**32 - 1, choice.randrange(2**32)))
                head = struct.pack("<IIq", 2**32 - 1, sequence, choice.choice((*I64, 0, 10**18)))
                await stream.send(head + noise.tobytes())
            await stream.send('{"type":"stop"}')
            async for text in stream:
                said = json.loads(text)
                assert said["type"] != "error", said


async def bad_names(port: int, choice: random.Random) -> None:
    """Names that are markup, paths, escapes, or none."""
    async with httpx2.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
        for name in ("%3Cimg%3E", "..", "a%00b", "-x", "x%0ay", "%F0%9F%98%80", "a" * 5000):
            answer = await client.put(f"/noise/{name}", content=b"x")
            assert 400 <= answer.status_code < 500, answer.text
        files = {"audio": (f"{MARKUP}\r\n.flac", RECORDING.read_bytes()[:20_000], MARKUP)}
        answer = await client.post("/localize", data={"array": MARKUP}, files=files)
        assert 400 <= answer.status_code < 500, answer.text
    for client_name in ("-x", MARKUP, "\ud800", "a\x00"):
        start = {"type": "start", "audio": {}, "array": {"name": ARRAY}, "client": client_name}
        async with connect(f"ws://127.0.0.1:{port}/stream", subprotocols=["doa.v1"]) as stream:
            await stream.send(json.dumps(start))
            assert json.loads(await stream.recv())["code"] == "message_invalid"


async def bad_profiles(port: int, choice: random.Random) -> None:
    """Noise profiles with some bytes changed; those that are still valid are deleted."""
    noise = 0.1 * np.random.default_rng(1).standard_normal((4, 80_000))
    good = noise_bytes(learn_noise([noise.astype(np.float32)], preset(ARRAY), Stft()))
    async with httpx2.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
        for _ in range(10):
            profile = bytearray(good)
            for _ in range(choice.randrange(1, 20)):
                place = choice.choice((choice.randrange(len(good)), choice.randrange(2000)))
                profile[place] = choice.randrange(256)
            answer = await client.put("/noise/bad", content=bytes(profile))
            assert answer.status_code in (200, 422), answer.text
            assert (await client.get("/noise")).status_code == 200
        await client.delete("/noise/bad")


async def heavy_start(port: int, choice: random.Random) -> None:
    """The largest stream that there is: taken or refused, and left at once."""
    angles = np.arange(32) * 2 * np.pi / 32
    ring = 0.1 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    start = {
        "type": "start",
        "audio": {"encoding": "pcm_f32le", "sample_rate": 384_000, "channels": 64},
        "array": {"positions_m": ring.round(4).tolist()},
        "channel_map": list(range(32)),
        "output": {"interval_ms": 20, "include": ["spectrum"]},
    }
    async with connect(f"ws://127.0.0.1:{port}/stream", subprotocols=["doa.v1"]) as stream:
        await stream.send(json.dumps(start))
        said = json.loads(await stream.recv())
        assert said["type"] == "ready" or said["code"] != "internal", said


async def many_uploads(port: int, choice: random.Random) -> None:
    """Uploads at once, of which some vanish in their midst, with requests behind them."""
    audio = RECORDING.read_bytes()
    head = b"Connection: close\r\nContent-Type: audio/flac\r\nContent-Length: %d\r\n\r\n"
    request = HEAD + head % len(audio) + audio

    async def upload() -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        if choice.random() < 0.8:
            writer.write(request[: choice.randrange(len(request))])
            with suppress(ConnectionError):
                await writer.drain()
        else:
            writer.write(request + HEAD)
            with suppress(ConnectionError):
                assert (await reader.read())[9:12] in (b"200", b"503")
        writer.transport.abort()

    await asyncio.gather(*(upload() for _ in range(UPLOADS)))


ATTACKS: dict[str, Attack] = {
    each.__name__.replace("_", " "): each
    for each in (
        flood,
        idle_crowd,
        slow_drips,
        never_reads,
        lying_stream,
        bad_names,
        bad_profiles,
        heavy_start,
        many_uploads,
    )
}
