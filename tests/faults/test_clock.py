"""The wall clock jumps while robots stream."""

from __future__ import annotations

import asyncio
import shutil
import struct
import subprocess
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import httpx2
import numpy as np
import pytest
from bench.fleet import Robot, fleet, until
from bench.robots import OPTIONS, start
from bench.served import Served
from websockets.asyncio.client import connect

SOURCE = Path(__file__).with_name("clock_shift.c")

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(shutil.which("cc") is None, reason="a C compiler is missing"),
]

ROBOTS = 3
HOUR = 3600.0
AFTER = 20


class Clock:
    """A process' wall clock that can be set, and its environment."""

    def __init__(self, folder: Path) -> None:
        library, self._shift = folder / "clock_shift.so", folder / "shift"
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, SOURCE], check=True)
        self.shift(0)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_SHIFT": str(self._shift)}

    def shift(self, seconds: float) -> None:
        """Set the clock ahead by a number of seconds."""
        with self._shift.open("r+b" if self._shift.exists() else "wb") as file:
            file.write(struct.pack("=q", round(seconds)))


@pytest.fixture
def clock(tmp_path: Path) -> Clock:
    return Clock(tmp_path)


def ahead_s(service: Served) -> float:
    """How far the service's wall clock is ahead of this one, by the answers' dates."""
    said = datetime.strptime(
        httpx2.get(f"{service.url}/livez").headers["date"], "%a, %d %b %Y %H:%M:%S GMT"
    )
    return (said.replace(tzinfo=UTC) - datetime.now(UTC)).total_seconds()


def test_clock_jumps(figures: Callable[..., None], clock: Clock) -> None:
    seen: list[float] = []

    async def scenario(service: Served) -> tuple[list[Robot], float, int]:
        silent = await connect(service.url.replace("http", "ws") + "/stream", **OPTIONS)
        await silent.send(start(100))
        async with fleet(service.url, ROBOTS) as robots:
            jumped = time.monotonic()
            for shift in (HOUR, -HOUR, 0.0):
                clock.shift(shift)
                await until(lambda: abs(ahead_s(service) - shift) < 60, "the clock jumps")  # noqa: B023
                seen.append(ahead_s(service))
                moment = time.monotonic()
                await until(
                    lambda: all(sum(h.arrived > moment for h in r.heard) >= AFTER for r in robots),  # noqa: B023
                    "robots hear",
                )
            running = service.running_sessions()
        await silent.close()
        return robots, jumped, running

    with Served(environment=clock.environment) as service:
        robots, jumped, running = asyncio.run(scenario(service))
        assert "Traceback" not in service.log, service.log[-3000:]
    lags = [lag for robot in robots for lag in robot.lags_ms(jumped)]
    figures(
        f"Wall clock by +1 h, -2 h, +1 h, {ROBOTS} robots and a silent stream",
        clock="service's dates " + ", ".join(f"{shift / HOUR:+.1f} h" for shift in seen),
        streams=f"{sum(robot.cut for robot in robots)} cut, "
        f"{ROBOTS + 1 - running} ended before their time",
        warnings=sum(len(robot.warnings) for robot in robots),
        lag=f"p99 {np.percentile(lags, 99):.0f} ms, most {max(lags):.0f} ms",
        audio_without_result=f"{max(robot.lost_s(jumped) for robot in robots):.1f} s",
    )
    assert running == ROBOTS + 1
    for robot in robots:
        assert robot.cut == 0
        assert "audio_gap" not in {warning.code for warning in robot.warnings}
        # Capture times are the robot's own, and go on as they did.
        assert np.all(np.diff([each.captured for each in robot.heard]) > 0)
        assert all(0 <= each.arrived - robot.began - each.captured < 60 for each in robot.heard)
    assert max(lags) < 60_000
