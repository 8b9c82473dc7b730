"""Clients that send what costs more to parse than it says, at full speed beside two robots."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import numpy as np
import pytest
from bench.fleet import Robot, fleet
from bench.requests_by_hand import FLOODS, pour
from bench.served import Served

pytestmark = pytest.mark.faults

ROBOTS = 2
FLOOD_S = 5.0
MOST_LAG_MS = 250


@pytest.mark.parametrize("kind", FLOODS)
def test_flood(figures: Callable[..., None], kind: str) -> None:
    async def scenario(service: Served) -> tuple[list[Robot], float, float]:
        async with fleet(service.url, ROBOTS) as robots:
            began = time.monotonic()
            # In a thread: the robots shall not wait for the attacker's own work.
            sent = await asyncio.to_thread(
                lambda: asyncio.run(pour(service.port, *FLOODS[kind], FLOOD_S))
            )
            return robots, began, sent

    with Served("--stream-workers", "1", "--workers", "1") as service:
        robots, began, sent = asyncio.run(scenario(service))
        assert "Traceback" not in service.log
    lags = [lag for robot in robots for lag in robot.lags_ms(began)]
    lost_s = max(robot.lost_s(began) for robot in robots)
    p99 = np.percentile(lags, 99)
    figures(
        f"A flood of {kind} for {FLOOD_S:g} s, {ROBOTS} robots beside it",
        sent=f"{sent:.0f} MB",
        others=f"{lost_s:.1f} s lost, lag p99 {p99:.0f} ms",
    )
    assert all(robot.cut == 0 for robot in robots)
    assert lost_s == 0
    assert p99 < MOST_LAG_MS
