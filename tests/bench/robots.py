"""Load of a running service: robots that stream in real time, beside clients that misbehave.

``python tests/bench/robots.py --robots 20 --seconds 60 --mute 1 --flood 1`` against a service that
runs on the same machine. Lag is the service's own figure (from the arrival of a result's last audio
to the result); age is measured here, from the sending of that audio to the result's arrival.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
import websockets
from websockets.asyncio.client import connect

RATE = 16_000
RECORDING = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
OPTIONS: dict[str, Any] = {"subprotocols": ["doa.v1"], "compression": None, "max_queue": None}


def start(interval_ms: int) -> str:
    return json.dumps(
        {
            "type": "start",
            "audio": {"encoding": "pcm_s16le", "sample_rate": RATE, "channels": 4},
            "array": {"name": "respeaker-usb-4mic-v2"},
            "output": {"interval_ms": interval_ms},
        }
    )


class Robot:
    """Streams the sample again and again, a message every ``chunk_s``, and reads the results."""

    def __init__(self, arguments: argparse.Namespace, audio: Any, index: int) -> None:
        self.arguments, self.audio = arguments, audio
        self.offset_s = index / arguments.robots * arguments.interval_ms / 1000
        self.lags: list[float] = []
        self.ages: list[float] = []
        self.warnings: list[str] = []

    async def run(self) -> None:
        async with connect(self.arguments.url, **OPTIONS) as socket:
            await socket.send(start(self.arguments.interval_ms))
            while json.loads(await socket.recv())["type"] != "ready":
                pass
            await asyncio.sleep(self.offset_s)
            began = time.monotonic()
            sending = asyncio.create_task(self._send(socket, began))
            async for text in socket:
                message = json.loads(text)
                if message["type"] == "result":
                    self.lags.append(message["lag_ms"])
                    self.ages.append(1000 * (time.monotonic() - began - message["t_end"]))
                elif message["type"] == "warning":
                    self.warnings.append(f"{message['code']}: {message['detail']}")
            await sending

    async def _send(self, socket: Any, began: float) -> None:
        chunk = round(self.arguments.chunk_s * RATE)
        sent = 0
        while sent < self.arguments.seconds * RATE:
            place = sent % (len(self.audio) - chunk)
            await asyncio.sleep(began + (sent + chunk) / RATE - time.monotonic())
            await socket.send(self.audio[place : place + chunk].tobytes())
            sent += chunk
        await socket.send('{"type":"stop"}')


async def misbehave(kind: str, url: str, seconds: float) -> None:
    """Never read, or send as fast as the socket takes it."""
    with suppress(websockets.ConnectionClosed):
        async with connect(url, **OPTIONS) as socket:
            await socket.send(start(20))
            await socket.recv()
            if kind == "mute":
                socket.transport.pause_reading()
            until = time.monotonic() + seconds
            while time.monotonic() < until:
                await socket.send(bytes(4096))
                if kind == "mute":
                    await asyncio.sleep(0.032)
            socket.transport.abort()


def misbehave_alone(kind: str, url: str, seconds: float) -> None:
    asyncio.run(misbehave(kind, url, seconds))


async def robots(arguments: argparse.Namespace) -> list[Robot]:
    audio, _ = soundfile.read(RECORDING, dtype="int16")
    fleet = [Robot(arguments, audio, index) for index in range(arguments.robots)]
    async with asyncio.TaskGroup() as group:
        for robot in fleet:
            group.create_task(robot.run())
    return fleet


def percentiles(values: list[float]) -> str:
    named = zip(
        ("p50", "p90", "p99", "most"), np.percentile(values, [50, 90, 99, 100]), strict=True
    )
    return ", ".join(f"{name} {value:.0f} ms" for name, value in named)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:8000/stream")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--interval-ms", type=int, default=100)
    parser.add_argument("--chunk-s", type=float, default=0.032)
    parser.add_argument("--mute", type=int, default=0, help="clients that never read")
    parser.add_argument("--flood", type=int, default=0, help="clients that send without pause")
    arguments = parser.parse_args()
    others = [
        multiprocessing.get_context("spawn").Process(
            target=misbehave_alone, args=(kind, arguments.url, arguments.seconds)
        )
        for kind, count in (("mute", arguments.mute), ("flood", arguments.flood))
        for _ in range(count)
    ]
    for other in others:
        other.start()
    fleet = asyncio.run(robots(arguments))
    for other in others:
        other.join()
    lags = [lag for robot in fleet for lag in robot.lags]
    ages = [age for robot in fleet for age in robot.ages]
    warnings = [warning for robot in fleet for warning in robot.warnings]
    print(f"{len(lags)} results; lag {percentiles(lags)}; age {percentiles(ages)}")
    print(f"{len(warnings)} warnings", *sorted(set(warnings))[:5], sep="\n  ")


if __name__ == "__main__":
    main()
