"""Robots that stream in real time through the project's client and account for every result.

Each robot numbers its audio by capture times that begin at 0 and go on through reconnections, so
that what was lost can be told from the results alone: a result stands for the audio between the
one before it and its own ``capture_time_ns``.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from neuralmusic import AsyncStreamClient
from neuralmusic.client_errors import ClientError
from neuralmusic.errors import DoaError
from neuralmusic.protocol.server_messages import (
    Calibrated,
    Ready,
    Result,
    StreamError,
    StreamWarning,
)
from neuralmusic.streams.inbox import Reconnecting

RATE = 16_000
ARRAY = "respeaker-usb-4mic-v2"
RECORDING = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
CHUNK = 512
"""Sample frames of a message: 32 ms"""
INTERVAL_MS = 100
POLL_S = 0.05
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Heard:
    """One result as a robot got it."""

    arrived: float
    """Monotonic seconds"""
    captured: float
    """Seconds of the robot's own audio"""
    lag_ms: float


@dataclass(slots=True)
class Robot:
    """One robot's stream and what came of it."""

    name: str
    url: str
    options: dict[str, Any] = field(default_factory=dict)
    heard: list[Heard] = field(default_factory=list)
    begun: list[float] = field(default_factory=list)
    """Moments of the monotonic clock at which sessions began"""
    errors: list[StreamError] = field(default_factory=list)
    reconnecting: list[Reconnecting] = field(default_factory=list)
    warnings: list[StreamWarning] = field(default_factory=list)
    calibrated: list[Calibrated] = field(default_factory=list)
    failure: DoaError | None = None
    """Error with which the client gave up"""
    stream: AsyncStreamClient | None = None
    began: float = 0.0

    async def run(self) -> None:
        """Stream until cancelled."""
        self.stream = AsyncStreamClient(
            self.url,
            audio={
                "encoding": "pcm_s16le",
                "sample_rate": RATE,
                "channels": 4,
                "header": "seq_time",
            },
            array=ARRAY,
            output={"interval_ms": INTERVAL_MS},
            wait_s=PATIENCE_S,
            **self.options,
        )
        async with self.stream:
            self.began = time.monotonic()
            sending = asyncio.create_task(self._send(self.stream))
            try:
                async for event in self.stream:
                    self._take(event)
            except DoaError as error:
                self.failure = error
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)

    def _take(self, event: Any) -> None:
        if isinstance(event, Result):
            assert event.capture_time_ns is not None
            captured = event.capture_time_ns / 1e9
            self.heard.append(Heard(time.monotonic(), captured, event.lag_ms))
        elif isinstance(event, Ready):
            self.begun.append(time.monotonic())
        elif isinstance(event, StreamError):
            self.errors.append(event)
        elif isinstance(event, Reconnecting):
            self.reconnecting.append(event)
        elif isinstance(event, StreamWarning):
            self.warnings.append(event)
        elif isinstance(event, Calibrated):
            self.calibrated.append(event)

    async def _send(self, stream: AsyncStreamClient) -> None:
        audio, _ = soundfile.read(RECORDING, dtype="int16")
        sent = 0
        while True:
            due = self.began + (sent + CHUNK) / RATE
            await asyncio.sleep(due - time.monotonic())
            place = sent % (len(audio) - CHUNK)
            with suppress(ClientError):  # whoever reads is told
                await stream.send(audio[place : place + CHUNK], sent * 1_000_000_000 // RATE)
            sent += CHUNK

    @property
    def cut(self) -> int:
        """How often the robot had to begin another session."""
        return max(len(self.begun) - 1, 0)

    def cut_after(self, moment: float) -> bool:
        """Whether it had to begin another session after a moment of the monotonic clock."""
        return bool(self.begun) and self.begun[-1] > moment

    def lost_s(self, since: float = 0.0) -> float:
        """Seconds of audio, captured after a moment of the monotonic clock, without a result."""
        captured = [each.captured for each in self.heard]
        before = max((c for c in captured if c + self.began < since), default=0.0)
        steps = np.diff([c for c in captured if c >= before])
        return float(np.sum(steps[steps > 1.5 * INTERVAL_MS / 1000] - INTERVAL_MS / 1000))

    def outage_s(self, since: float) -> float:
        """The longest time without a result after a moment of the monotonic clock."""
        moments = [since, *(each.arrived for each in self.heard if each.arrived > since)]
        return float(np.max(np.diff(moments), initial=0.0))

    def lags_ms(self, since: float = 0.0, until: float = np.inf) -> list[float]:
        """Lags of the results that arrived between two moments of the monotonic clock."""
        return [each.lag_ms for each in self.heard if since <= each.arrived < until]


def recording(times: int) -> bytes:
    """The sample so many times over, as a WAV file."""
    samples, rate = soundfile.read(RECORDING, dtype="int16")
    file = BytesIO()
    soundfile.write(file, np.tile(samples, (times, 1)), rate, format="WAV")
    return file.getvalue()


@asynccontextmanager
async def fleet(url: str, count: int, **options: Any) -> AsyncIterator[list[Robot]]:
    """So many robots, all of which hear something already."""
    robots = [Robot(f"robot-{index}", url, options) for index in range(count)]
    tasks = []
    try:
        for robot in robots:
            tasks.append(asyncio.create_task(robot.run()))
            await asyncio.sleep(INTERVAL_MS / 1000 / count)  # not all at the same moment
        await until(lambda: all(len(robot.heard) >= 10 for robot in robots), "all robots hear")
        yield robots
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def until(
    condition: Callable[[], bool], what: str = "", patience_s: float = PATIENCE_S
) -> float:
    """Wait until a condition holds; the seconds that it took."""
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > patience_s:
            raise TimeoutError(f"waited {patience_s:g} s in vain until {what}")
        await asyncio.sleep(POLL_S)
    return time.monotonic() - began
