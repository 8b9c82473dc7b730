"""Hang-up signals by the hundred, and a second service at the same port."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import httpx2
import pytest
from bench.fleet import fleet, until
from bench.served import COMMAND, ROOT, Served

pytestmark = pytest.mark.faults

SIGNALS = 200
DEADLINE_S = 60.0


def test_a_storm_of_reloads(figures: Callable[..., None]) -> None:
    def post(url: str) -> int:
        return httpx2.post(f"{url}/admin/reload", timeout=DEADLINE_S).status_code

    async def scenario(service: Served) -> tuple[list[int], float, int]:
        async with fleet(service.url, 2) as robots:
            began = time.monotonic()
            for _ in range(SIGNALS):
                service.process.send_signal(signal.SIGHUP)
            with ThreadPoolExecutor(4) as threads:
                loop = asyncio.get_running_loop()
                asked = [loop.run_in_executor(threads, post, service.url) for _ in range(4)]
                answers = await asyncio.gather(*asked)
            took = time.monotonic() - began
            await until(
                lambda: all(sum(h.arrived > began + took for h in r.heard) >= 10 for r in robots),
                "robots hear",
            )
            return answers, took, sum(robot.cut for robot in robots)

    with Served("--log-level", "info") as service:
        answers, took, cut = asyncio.run(scenario(service))
        reloads = service.log.count("the models were reloaded")
    figures(
        f"{SIGNALS} SIGHUPs and four `POST /admin/reload` at once, 2 robots",
        answers=", ".join(map(str, answers)),
        after=f"{took:.1f} s",
        reloads=reloads,
        streams=f"{cut} of 2 cut",
    )
    assert answers == 4 * [200]
    assert 1 <= reloads <= 3
    assert cut == 0


def test_a_port_that_is_taken(figures: Callable[..., None]) -> None:
    with Served() as service:
        port = service.url.rpartition(":")[2]
        began = time.monotonic()
        ended = subprocess.run(
            [COMMAND, "serve", "--port", port],
            env={**os.environ, "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}"},
            capture_output=True,
            text=True,
            timeout=60,
        )
        took = time.monotonic() - began
    figures(
        "A second service at the same port",
        exit_status=f"{ended.returncode} after {took:.1f} s",
        says=f"“{ended.stderr.strip().replace(port, 'PORT')}”",
    )
    assert ended.returncode == 2
    assert f"port {port}" in ended.stderr
    assert "--port" in ended.stderr
    assert "models are loaded" not in ended.stderr
