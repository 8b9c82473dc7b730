"""Worker processes are killed or stopped while robots stream and recordings are localized."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np
import pytest
from bench.fleet import ARRAY, RECORDING, Robot, fleet, recording, until
from bench.served import Footprint, Served, children, command_line, cpu_s

pytestmark = pytest.mark.faults

ROBOTS = 10
BACK_S = 10.0
"""Seconds within which every robot that was cut must get a message again"""
IDLE_THREADS = 2
"""Threads of asyncio's pool, which keeps those it started"""
AFTER = 20
"""Results that every robot must get after the fault"""


def again(robots: list[Robot], since: float) -> Callable[[], bool]:
    """Whether every robot got results after a moment."""
    return lambda: all(sum(h.arrived > since for h in robot.heard) >= AFTER for robot in robots)


def milliseconds(robots: list[Robot], since: float = 0.0, until: float = np.inf) -> str:
    lags = [lag for robot in robots for lag in robot.lags_ms(since, until)]
    p50, p99 = np.percentile(lags, [50, 99])
    return f"p50 {p50:.0f} ms, p99 {p99:.0f} ms"


def test_stream_worker_killed(figures: Callable[..., None]) -> None:
    async def scenario(service: Served) -> tuple[list[Robot], float, Footprint, Footprint]:
        async with fleet(service.url, ROBOTS) as robots:
            await until(lambda: len(service.workers("workers.stream")) == 2, "two workers run")
            await until(again(robots, time.monotonic()), "all robots hear")
            before = service.footprint()
            killed = time.monotonic()
            os.kill(service.workers("workers.stream")[0], signal.SIGKILL)
            await until(again(robots, killed), "all robots hear again", 6 * BACK_S)
            await until(lambda: service.running_sessions() == ROBOTS, "no session is left over")
            await until(lambda: service.footprint().files <= before.files, "files are closed")
            return robots, killed, before, service.footprint()

    with Served("--stream-workers", "2") as service:
        robots, killed, before, after = asyncio.run(scenario(service))
        log = service.log
    cut = [robot for robot in robots if robot.cut]
    others = [robot for robot in robots if not robot.cut]
    figures(
        f"SIGKILL of one of two stream workers, {ROBOTS} robots",
        cut=f"{len(cut)} of {ROBOTS} streams, each with `worker_lost` and 1011",
        back_within=f"{max(robot.outage_s(killed) for robot in cut):.1f} s",
        audio_without_result=f"{max(r.lost_s(killed) for r in cut):.1f} s at most a robot",
        others=f"lost {sum(r.lost_s(killed) for r in others):.1f} s, "
        f"lag {milliseconds(others, until=killed)} before, {milliseconds(others, killed)} after",
        files=f"{before.files} before, {after.files} after",
        memory=f"{before.pss_mb:.0f} MB before, {after.pss_mb:.0f} MB after",
    )
    assert cut
    assert others
    for robot in cut:
        assert [(e.code, e.close_code, e.retryable) for e in robot.errors] == [
            ("worker_lost", 1011, True)
        ]
        assert robot.cut == 1
        assert robot.outage_s(killed) < BACK_S
    for robot in others:
        assert not robot.errors
        assert not robot.reconnecting
    assert after.processes == before.processes
    assert after.threads <= before.threads + IDLE_THREADS
    assert "Traceback" not in log


def test_stream_worker_stopped(figures: Callable[..., None]) -> None:
    async def scenario(service: Served) -> tuple[list[Robot], float]:
        async with fleet(service.url, ROBOTS) as robots:
            await until(lambda: len(service.workers("workers.stream")) == 2, "two workers run")
            await until(again(robots, time.monotonic()), "all robots hear")
            victim = service.workers("workers.stream")[0]
            stopped = time.monotonic()
            os.kill(victim, signal.SIGSTOP)
            try:
                await until(again(robots, stopped), "all robots hear again", 4 * BACK_S)
            finally:
                if command_line(victim):
                    os.kill(victim, signal.SIGKILL)
            return robots, stopped

    with Served("--stream-workers", "2") as service:
        robots, stopped = asyncio.run(scenario(service))
    cut = [robot for robot in robots if robot.cut]
    figures(
        f"SIGSTOP of one of two stream workers, {ROBOTS} robots",
        cut=f"{len(cut)} of {ROBOTS} streams, each with `worker_lost`",
        back_within=f"{max(robot.outage_s(stopped) for robot in cut):.1f} s",
    )
    assert all({error.code for error in robot.errors} == {"worker_lost"} for robot in cut)


def busiest(service: Served) -> int | None:
    """The recordings' worker that has computed most; None where threads do it."""
    pids = [p for p in children(service.pid) if "workers.stream" not in command_line(p)]
    return max(pids, key=cpu_s, default=None)


def test_recording_worker_killed(figures: Callable[..., None]) -> None:
    long = recording(20)
    answers: list[httpx2.Response] = []

    def ask(service: Served, audio: bytes) -> httpx2.Response:
        files: Any = {"audio": audio}
        return httpx2.post(
            f"{service.url}/localize", data={"array": ARRAY}, files=files, timeout=120
        )

    with Served("--workers", "2") as service:
        short = RECORDING.read_bytes()
        assert ask(service, short).status_code == 200
        if busiest(service) is None:
            pytest.skip("recordings are localized by threads, which cannot be killed")
        started = {pid: cpu_s(pid) for pid in children(service.pid)}
        asking = threading.Thread(target=lambda: answers.append(ask(service, long)))
        asking.start()
        victims: list[int] = []

        def computing() -> bool:
            victims[:] = [
                pid
                for pid in children(service.pid)
                if "workers.stream" not in command_line(pid)
                and cpu_s(pid) > started.get(pid, 0) + 0.3
            ]
            return bool(victims)

        asyncio.run(until(computing, "a worker computes"))
        assert not answers, "the recording is too short to be interrupted"
        killed = time.monotonic()
        for victim in victims:
            os.kill(victim, signal.SIGKILL)
        asking.join(60)
        told = time.monotonic() - killed
        retried = ask(service, long)
        log = service.log
    (lost,) = answers
    figures(
        "SIGKILL of the worker that localizes a recording",
        answer=f"{lost.status_code} `{lost.json()['code']}` after {told:.1f} s",
        retry=retried.status_code,
    )
    assert (lost.status_code, lost.json()["code"]) == (503, "worker_lost")
    assert "Retry-After" in lost.headers
    assert retried.status_code == 200
    assert "Traceback" not in log
