"""Streams that cost as much as a core beside two robots in real time."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Coroutine

import numpy as np
import pytest
import websockets
from bench.fleet import Robot, fleet
from bench.served import Served

from neuralmusic.protocol import SUBPROTOCOL

pytestmark = pytest.mark.faults

ROBOTS = 2
SECONDS = 6.0
MOST_LAG_MS = 250
HERTZ, CHANNELS, MICROPHONES = 384_000, 64, 32
MESSAGE_FRAMES = 960
"""Sample frames of a message: 245 kB"""


def ring(microphones: int, seed: int) -> list[list[float]]:
    angles = 2 * np.pi * np.arange(microphones) / microphones
    places = np.stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), 0 * angles], axis=1)
    error = 1e-3 * np.random.default_rng(seed).standard_normal((microphones, 2))
    places[:, :2] += error
    found: list[list[float]] = places.tolist()
    return found


async def loud(url: str) -> int:
    """Valid real-time audio of 64 channels at 384 kHz for 32 microphones; messages sent."""
    start = {
        "type": "start",
        "method": "music",
        "audio": {"encoding": "pcm_f32le", "sample_rate": HERTZ, "channels": CHANNELS},
        "array": {"positions_m": ring(MICROPHONES, 0)},
        "channel_map": list(range(MICROPHONES)),
        "output": {"interval_ms": 1000},
    }
    noise = np.random.default_rng(0).standard_normal((MESSAGE_FRAMES, CHANNELS)).astype("<f4")
    sent = 0
    async with websockets.connect(url, subprotocols=[SUBPROTOCOL]) as socket:
        await socket.send(json.dumps(start))
        assert json.loads(await socket.recv())["type"] == "ready"
        begin = time.monotonic()  # its worker has started
        while time.monotonic() < begin + SECONDS:
            await socket.send(noise.tobytes())
            sent += 1
            await asyncio.sleep(max(0, begin + sent * MESSAGE_FRAMES / HERTZ - time.monotonic()))
    return sent


async def opening(url: str) -> int:
    """Streams of 32 microphones, each of another array, that begin and end; their number."""
    opened, begin = 0, time.monotonic()
    while time.monotonic() < begin + SECONDS:
        async with websockets.connect(url, subprotocols=[SUBPROTOCOL]) as socket:
            audio = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": MICROPHONES}
            array = {"positions_m": ring(MICROPHONES, opened)}
            await socket.send(json.dumps({"type": "start", "audio": audio, "array": array}))
            assert json.loads(await socket.recv())["type"] == "ready"
        opened += 1
        if opened == 1:
            begin = time.monotonic()  # its worker has started
    return opened


@pytest.mark.parametrize("attack", [loud, opening])
def test_heavy_neighbour(
    figures: Callable[..., None], attack: Callable[[str], Coroutine[None, None, int]]
) -> None:
    async def scenario(service: Served) -> tuple[list[Robot], float, int]:
        url = service.url.replace("http", "ws", 1) + "/stream"
        async with fleet(service.url, ROBOTS) as robots:
            began = time.monotonic()
            done = await asyncio.to_thread(lambda: asyncio.run(attack(url)))
            return robots, began, done

    with Served("--stream-workers", "2", "--workers", "1") as service:
        robots, began, done = asyncio.run(scenario(service))
        assert "Traceback" not in service.log
    lags = [lag for robot in robots for lag in robot.lags_ms(began)]
    lost_s = max(robot.lost_s(began) for robot in robots)
    p99 = np.percentile(lags, 99)
    figures(
        f"A stream of 32 microphones ({attack.__name__}) for {SECONDS:g} s, {ROBOTS} robots beside",
        done=str(done),
        others=f"{lost_s:.1f} s lost, lag p99 {p99:.0f} ms",
    )
    assert done > 3
    assert all(robot.cut == 0 for robot in robots)
    assert lost_s == 0
    assert p99 < MOST_LAG_MS
