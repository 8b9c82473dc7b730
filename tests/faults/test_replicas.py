"""One replica of three behind HAProxy is killed while robots stream and recordings are posted."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import Callable

import httpx2
import pytest
from bench.fleet import ARRAY, RECORDING, Robot, fleet, until
from bench.proxy import Proxy, installed
from bench.served import Served

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(installed() is None, reason="haproxy is not installed"),
]

ROBOTS = 9
AFTER = 20
BACK_S = 15.0


async def upload(url: str, answers: Counter[str]) -> None:
    """Post the sample again and again."""
    async with httpx2.AsyncClient(timeout=30) as client:
        while True:
            try:
                with RECORDING.open("rb") as audio:
                    response = await client.post(
                        f"{url}/localize", data={"array": ARRAY}, files={"audio": audio}
                    )
                answers[str(response.status_code)] += 1
            except httpx2.TransportError as error:
                answers[type(error).__name__] += 1


def test_one_replica_of_three_killed(figures: Callable[..., None]) -> None:
    answers: Counter[str] = Counter()

    async def scenario(proxy: Proxy, replicas: list[Served]) -> tuple[list[Robot], float, int]:
        async with fleet(proxy.url, ROBOTS) as robots:
            uploading = asyncio.create_task(upload(proxy.url, answers))
            await until(lambda: answers["200"] >= 3, "recordings are answered")
            carried = replicas[0].running_sessions()
            killed = time.monotonic()
            replicas[0].process.kill()
            await until(
                lambda: all(sum(h.arrived > killed for h in r.heard) >= AFTER for r in robots),
                "all robots hear again",
            )
            answered = answers["200"]
            await until(lambda: answers["200"] >= answered + 3, "recordings are answered again")
            uploading.cancel()
            survivors = sum(replica.running_sessions() for replica in replicas[1:])
            assert survivors == ROBOTS
            return robots, killed, carried

    with contextlib.ExitStack() as stack:
        replicas = [
            stack.enter_context(Served("--stream-workers", "1", "--workers", "1")) for _ in range(3)
        ]
        proxy = stack.enter_context(Proxy([replica.port for replica in replicas]))
        robots, killed, carried = asyncio.run(scenario(proxy, replicas))
    cut = [robot for robot in robots if robot.cut_after(killed)]
    failed = answers.total() - answers["200"]
    figures(
        f"SIGKILL of one of three replicas behind HAProxy, {ROBOTS} robots and uploads",
        cut=f"{len(cut)} of {ROBOTS} streams",
        back_within=f"{max(robot.outage_s(killed) for robot in cut):.1f} s",
        audio_without_result=f"{max(robot.lost_s(killed) for robot in cut):.1f} s at most a robot",
        uploads=f"{answers['200']} answered, {failed} not "
        f"({', '.join(k for k in answers if k != '200') or 'none'})",
    )
    assert len(cut) == carried > 0
    assert all(robot.outage_s(killed) < BACK_S for robot in cut)
    assert failed <= 2  # the one that was in the replica, and one that found it gone
