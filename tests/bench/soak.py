"""Robots, churn, uploads and faults for a while, to see whether anything grows.

``python tests/bench/soak.py --minutes 30`` starts a service of its own, writes ``docs/soak.json``
and ``docs/soak.png``, prints a verdict and exits with 1 where a bound is broken.

A worker that was replaced makes a step in the memory of all processes together, and in the shares
(PSS) of those that remain: a slope through steps says nothing. So the slope is that of what the
*service's own process* allocated (anonymous memory), which lives through everything, by Theil and
Sen (the median of the slopes of all pairs: no spike decides it) with its 95 % confidence interval.
Bundles are reloaded during the warm-up only: every reload leaves a little in the allocator, which
has a figure of its own in ``docs/reliability.md``.
Half of the interval is what the run resolves; runs of less than ten minutes cannot tell a megabyte
an hour, and are judged by the memory at rest before and after.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from attacks import ATTACKS, Attack
from fleet import ARRAY, RECORDING, Robot, until
from reliability import write_table
from scipy.stats import theilslopes
from served import Footprint, Served

from neuralmusic.errors import DoaError

SAMPLE_S = 5.0
WARM_UP = 1 / 6
"""Share of the time, at least half a minute, in which caches fill and first requests come"""
MB_AN_HOUR = 1.0
TELLS_SLOPES_S = 600.0
"""Seconds from which slopes are judged; a shorter run is judged by its memory at rest"""
MB_AT_REST = 20.0
RELOADS = 5
"""Reloads after which the allocator has all that reloads ever fragment (measured: 40 MB)"""
SIGNALS = 50
"""SIGHUPs at once, which are two reloads at most"""
PAUSE_S = 2.0, 5.0
"""Least and most seconds between two faults"""
SETTLE_S = 60.0
OPTIONS = (
    {"interval_ms": 50},
    {"interval_ms": 100},
    {"interval_ms": 200, "include": ["spectrum"]},
    {"interval_ms": 100, "format": "doa", "yaw_deg": 30.0},
)


@dataclass(frozen=True, slots=True)
class Sample:
    """The service at one moment."""

    t: float
    """Seconds from the beginning"""
    service_mb: float
    """Memory that the service's own process allocated"""
    whole_mb: float
    """PSS of the service and all workers"""
    processes: int
    threads: int
    """Threads of the service's own process, as are files and sockets"""
    files: int
    sockets: int
    sessions: int
    lag_p50_ms: float
    lag_p99_ms: float


class Soak:
    """One run.

    Parameters
    ----------
    service : Served
    robots : int
    seconds : float
    seed : int
        Seed of all random choices.
    """

    def __init__(self, service: Served, robots: int, seconds: float, seed: int) -> None:
        self.service = service
        self.count = robots
        self.seconds = seconds
        self.random = random.Random(seed)
        self.robots: dict[int, tuple[Robot, asyncio.Task[None]]] = {}
        self.samples: list[Sample] = []
        self.faults: dict[str, int] = {}
        self.uploads: dict[str, int] = {}
        self.results = 0
        self.warm_s = max(30.0, WARM_UP * seconds)
        self.began = 0.0
        self._numbers = iter(range(10**9))
        self._seen = 0.0

    async def run(self) -> tuple[Footprint, Footprint]:
        """Everything at once until the time is over; the footprints before and after."""
        await self._once_of_each()
        before = await self._at_rest()
        self.began = self._seen = time.monotonic()
        for _ in range(self.count):
            self._join()
        tasks = [
            asyncio.create_task(each)
            for each in (self._sample(), self._churn(), self._upload(), self._break())
        ]
        await asyncio.wait(tasks, timeout=self.seconds, return_when=asyncio.FIRST_EXCEPTION)
        for task in tasks:
            task.cancel()
        for ended in await asyncio.gather(*tasks, return_exceptions=True):
            if isinstance(ended, Exception):
                raise ended
        await asyncio.wait([self.attack])  # a thread cannot be cancelled
        for number in list(self.robots):
            await self._leave(number)
        return before, await self._at_rest()

    async def _once_of_each(self) -> None:
        """What is loaded once is no leak, nor what the allocator keeps of the first reloads."""
        for _ in range(RELOADS):
            self.service.process.send_signal(signal.SIGHUP)
            await asyncio.sleep(SAMPLE_S)
        robot = Robot("first", self.service.url)
        task = asyncio.create_task(robot.run())
        await until(lambda: len(robot.heard) >= 10, "the first robot hears")
        await self._post()
        await asyncio.gather(*map(self._attack, ATTACKS.values()))
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    async def _at_rest(self) -> Footprint:
        """The footprint once no stream runs and files are closed."""
        await until(lambda: self.service.running_sessions() == 0, "no stream runs", SETTLE_S)
        await asyncio.sleep(SAMPLE_S + 1)  # uvicorn keeps idle connections for five seconds
        return self.service.footprint(workers=False)

    def _join(self, **options: Any) -> None:
        number = next(self._numbers)
        robot = Robot(f"robot-{number}", self.service.url, options)
        self.robots[number] = robot, asyncio.create_task(robot.run())

    async def _leave(self, number: int) -> None:
        robot, task = self.robots.pop(number)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        self.results += len(robot.heard)

    async def _sample(self) -> None:
        number = 0
        while True:
            number += 1
            await asyncio.sleep(self.began + number * SAMPLE_S - time.monotonic())
            since, self._seen = self._seen, time.monotonic()
            lags = [lag for robot, _ in self.robots.values() for lag in robot.lags_ms(since)]
            p50, p99 = np.percentile(lags, [50, 99]) if lags else (np.nan, np.nan)
            sessions = await asyncio.to_thread(self.service.running_sessions)
            whole, own = self.service.footprint(), self.service.footprint(workers=False)
            self.samples.append(
                Sample(
                    t=round(self._seen - self.began, 2),
                    service_mb=whole.heap_mb,
                    whole_mb=whole.pss_mb,
                    processes=whole.processes,
                    threads=own.threads,
                    files=own.files,
                    sockets=own.sockets,
                    sessions=sessions,
                    lag_p50_ms=round(float(p50), 1),
                    lag_p99_ms=round(float(p99), 1),
                )
            )

    async def _churn(self) -> None:
        """Robots leave in order, vanish, come, change options."""
        while True:
            await asyncio.sleep(self.random.uniform(1, 4))
            number = self.random.choice(list(self.robots))
            robot, _ = self.robots[number]
            what = self.random.choice(("leave", "vanish", "update", "update"))
            if what == "update":
                with suppress(DoaError):
                    if robot.stream is not None:
                        robot.stream.update(**self.random.choice(OPTIONS))
                continue
            if what == "leave" and robot.stream is not None:
                with suppress(DoaError):
                    await robot.stream.stop()
            await self._leave(number)
            self._join()

    async def _upload(self) -> None:
        while True:
            await asyncio.sleep(self.random.uniform(2, 8))
            await self._post()

    async def _post(self) -> None:
        async with httpx2.AsyncClient(timeout=60) as client:
            with RECORDING.open("rb") as audio:
                answer = await client.post(
                    f"{self.service.url}/localize", data={"array": ARRAY}, files={"audio": audio}
                )
        key = str(answer.status_code)
        self.uploads[key] = self.uploads.get(key, 0) + 1

    async def _break(self) -> None:
        """One fault or attack every few seconds, the same kinds again and again."""
        faults: dict[str, Callable[[], Awaitable[None]]] = {
            "stream worker killed": self._kill_stream_worker,
            "recording worker killed": self._kill_recording_worker,
            "connection reset": self._reset,
            "bad messages": self._bad_messages,
            "bundles reloaded": self._reload,
            **{name: partial(self._attack, attack) for name, attack in ATTACKS.items()},
        }
        while True:
            for name, fault in self.random.sample(sorted(faults.items()), len(faults)):
                await asyncio.sleep(self.random.uniform(*PAUSE_S))
                if fault != self._reload or time.monotonic() - self.began < self.warm_s:
                    await fault()
                    self.faults[name] = self.faults.get(name, 0) + 1

    async def _attack(self, attack: Attack) -> None:
        """In a thread: the robots shall not wait for the attacker's own work."""
        choice = random.Random(self.random.random())
        self.attack = asyncio.ensure_future(
            asyncio.to_thread(lambda: asyncio.run(attack(self.service.port, choice)))
        )
        await self.attack

    async def _kill_stream_worker(self) -> None:
        self._kill("workers.stream")

    async def _kill_recording_worker(self) -> None:
        self._kill("workers.recording")

    def _kill(self, kind: str) -> None:
        workers = self.service.workers(kind)
        if workers:
            with suppress(ProcessLookupError):
                os.kill(self.random.choice(workers), signal.SIGKILL)

    async def _reset(self) -> None:
        """Half an upload and half a handshake, then RST."""
        for said in (b"POST /localize HTTP/1.1\r\nContent-Length: 99\r\n\r\nx", b"GET /stream HT"):
            _, writer = await asyncio.open_connection("127.0.0.1", self.service.port)
            writer.write(said)
            await writer.drain()
            writer.transport.abort()

    async def _bad_messages(self) -> None:
        async with httpx2.AsyncClient(timeout=60) as client:
            for body in (b"", b"RIFF", bytes(100_000)):
                answer = await client.post(
                    f"{self.service.url}/localize?array={ARRAY}",
                    content=body,
                    headers={"Content-Type": "audio/wav"},
                )
                assert 400 <= answer.status_code < 500, answer.text
        wrong = Robot("wrong", self.service.url, {"channel_map": [0, 1, 2, 63]})
        with suppress(DoaError):
            await wrong.run()

    async def _reload(self) -> None:
        for _ in range(SIGNALS):
            self.service.process.send_signal(signal.SIGHUP)
            await asyncio.sleep(0)


def judged(soak: Soak, before: Footprint, after: Footprint) -> list[dict[str, Any]]:
    """Every bound with what was measured."""
    kept = [sample for sample in soak.samples if sample.t >= soak.warm_s]
    hours = np.array([sample.t for sample in kept]) / 3600
    memory = theilslopes([sample.service_mb for sample in kept], hours)
    lag = theilslopes([sample.lag_p50_ms for sample in kept], hours / hours.max())
    p50, p99 = (
        float(np.median([getattr(sample, name) for sample in kept]))
        for name in ("lag_p50_ms", "lag_p99_ms")
    )
    resolved = (memory.high_slope - memory.low_slope) / 2
    grown = after.heap_mb - before.heap_mb
    return [
        {
            "what": "memory of the service's process, slope after warm-up",
            "measured": f"{memory.slope:+.2f} MB an hour, resolved to ±{resolved:.2f}",
            "bound": f"below {MB_AN_HOUR:g} MB an hour"
            if soak.seconds >= TELLS_SLOPES_S
            else "not told by so short a run",
            "kept": bool(memory.slope < MB_AN_HOUR or soak.seconds < TELLS_SLOPES_S),
        },
        {
            "what": "memory of the service's process at rest",
            "measured": f"{before.heap_mb:.1f} MB before, {after.heap_mb:.1f} MB after",
            "bound": f"at most {MB_AT_REST:g} MB more",
            "kept": grown <= MB_AT_REST,
        },
        {
            "what": "drift of the median lag over the run",
            "measured": f"{lag.slope:+.1f} ms (95 %: {lag.low_slope:+.1f} to "
            f"{lag.high_slope:+.1f}) at p50 {p50:.0f} ms, p99 {p99:.0f} ms",
            "bound": "the interval reaches below 5 ms",
            "kept": bool(lag.low_slope < 5),
        },
        {
            "what": "streams left over",
            "measured": str(soak.service.running_sessions()),
            "bound": "0",
            "kept": soak.service.running_sessions() == 0,
        },
        *(
            {
                "what": f"{name} of the service's process at rest",
                "measured": f"{getattr(before, name)} before, {getattr(after, name)} after",
                "bound": f"at most {slack} more",
                "kept": bool(getattr(after, name) <= getattr(before, name) + slack),
            }
            for name, slack in (("threads", 8), ("files", 6), ("sockets", 6))
        ),
        {
            "what": "tracebacks in the log",
            "measured": str(soak.service.log.count("Traceback")),
            "bound": "0",
            "kept": "Traceback" not in soak.service.log,
        },
    ]


def picture(soak: Soak, path: Path) -> None:
    """Memory, lag and what is open over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    minutes = [sample.t / 60 for sample in soak.samples]
    figure, axes = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
    rows = (
        ("MB", (("service_mb", "service alone, allocated"), ("whole_mb", "with workers, PSS"))),
        ("lag in ms", (("lag_p50_ms", "p50"), ("lag_p99_ms", "p99"))),
        ("open", (("sockets", "sockets"), ("files", "files"), ("threads", "threads"))),
    )
    for axis, (label, lines) in zip(axes, rows, strict=True):
        for name, says in lines:
            axis.plot(minutes, [getattr(sample, name) for sample in soak.samples], label=says)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend(loc="upper left", ncols=3)
    axes[-1].set_xlabel("minutes")
    figure.savefig(path, dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("docs"))
    arguments = parser.parse_args()
    with Served() as service:
        soak = Soak(service, arguments.robots, 60 * arguments.minutes, arguments.seed)
        before, after = asyncio.run(soak.run())
        judgements = judged(soak, before, after)
    report = {
        "minutes": arguments.minutes,
        "robots": arguments.robots,
        "results": soak.results,
        "faults": soak.faults,
        "uploads": soak.uploads,
        "judgements": judgements,
        "samples": [asdict(sample) for sample in soak.samples],
    }
    (arguments.folder / "soak.json").write_text(json.dumps(report, indent=1) + "\n")
    write_table(arguments.folder)
    picture(soak, arguments.folder / "soak.png")
    print(f"{soak.results} results; faults {soak.faults}; uploads {soak.uploads}")
    for each in judgements:
        verdict = "kept  " if each["kept"] else "BROKEN"
        print(f"{verdict}  {each['what']}: {each['measured']} ({each['bound']})")
    return 0 if all(each["kept"] for each in judgements) else 1


if __name__ == "__main__":
    sys.exit(main())
