"""What the service costs: windows, streams, files, memory, start; beside pyroomacoustics.

``make bench`` prints the tables; ``python tests/bench/performance.py --out docs`` also writes
``performance.json`` and renews the tables of ``performance.md`` there. Nothing else should run on
the machine meanwhile.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import soundfile
from performance_report import tables, write_tables
from robots import OPTIONS, RATE, RECORDING, robots, start
from roofline import roofline
from served import COMMAND, Served, children, cpu_s, pss_mb
from websockets.asyncio.client import connect

INTERVAL_MS = 100
LAG_BOUND_MS = 250
RECORDINGS = 3
"""Files of one length, one after the other"""
PART_S = 60
"""An hour's file is written minute by minute"""


def windows(repeats: int) -> dict[str, Any]:
    """``neuralmusic bench`` on one thread."""
    command = [COMMAND, "bench", "--threads", "1", "--json", "--repeats", str(repeats)]
    said = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    figures: dict[str, Any] = json.loads(said)
    return figures


def cold_starts(runs: int) -> dict[str, float]:
    """Seconds from the start of ``neuralmusic serve`` to its first 200 of /readyz."""
    times = []
    for _ in range(runs):
        began = time.monotonic()
        with Served() as served:
            while httpx2.get(f"{served.url}/readyz").status_code != 200:
                time.sleep(0.01)
            times.append(time.monotonic() - began)
    return {"median_s": round(statistics.median(times), 2), "most_s": round(max(times), 2)}


def fleet(count: int, seconds: float) -> dict[str, float]:
    """So many robots in real time, the load on the same machine."""
    with Served("--max-sessions", str(count + 8)) as served:
        options = argparse.Namespace(
            url=served.url.replace("http", "ws") + "/stream",
            robots=count,
            seconds=seconds,
            interval_ms=INTERVAL_MS,
            chunk_s=0.032,
        )
        asyncio.run(robots(argparse.Namespace(**{**vars(options), "seconds": 3.0})))
        pids = [served.pid, *children(served.pid)]
        before = sum(map(cpu_s, pids)), cpu_s(os.getpid())
        fleet = asyncio.run(robots(options))
        service, client = sum(map(cpu_s, pids)) - before[0], cpu_s(os.getpid()) - before[1]
    lags = [lag for robot in fleet for lag in robot.lags]
    p50, p99 = np.percentile(lags, [50, 99])
    return {
        "robots": count,
        "results": len(lags),
        "lag_p50_ms": round(float(p50), 1),
        "lag_p99_ms": round(float(p99), 1),
        "lag_most_ms": round(max(lags), 1),
        "warnings": sum(len(robot.warnings) for robot in fleet),
        "service_share_of_a_core_per_stream": round(service / seconds / count, 4),
        "client_share_of_a_core_per_stream": round(client / seconds / count, 4),
    }


def fleets(counts: list[int], seconds: float) -> list[dict[str, float]]:
    """Ever more robots, until the lag's 99th percentile passes the bound."""
    found = []
    for count in counts:
        found.append(fleet(count, seconds))
        if found[-1]["lag_p99_ms"] > LAG_BOUND_MS:
            break
    return found


def files(lengths_s: list[int]) -> list[dict[str, Any]]:
    """Four-channel recordings through ``POST /localize`` with its defaults, medians of a few."""
    found: list[dict[str, Any]] = []
    for seconds in lengths_s:
        with Served("--workers", "1") as served, tempfile.TemporaryDirectory() as folder:
            (worker,) = served.workers("workers.recording")
            path = Path(folder) / "long.wav"
            write_recording(path, seconds)
            at_rest, computed, spent = family_mb(worker), cpu_s(worker), []
            with watched(worker) as megabytes:
                for _ in range(RECORDINGS):
                    began = time.monotonic()
                    answer = _localized(served.url, path)
                    spent.append(time.monotonic() - began)
            seconds_spent = statistics.median(spent)
            found.append(
                {
                    "audio_s": seconds,
                    "windows": len(answer.json()["windows"]),
                    "seconds": round(seconds_spent, 2),
                    "seconds_least_most": [round(min(spent), 2), round(max(spent), 2)],
                    "times_real_time": round(seconds / seconds_spent, 1),
                    "worker_cpu_s": round((cpu_s(worker) - computed) / RECORDINGS, 2),
                    "worker_peak_mb": round(max(megabytes), 1),
                    "worker_at_rest_mb": round(at_rest, 1),
                    "answer_mb": round(len(answer.content) / 1e6, 1),
                }
            )
    return found


def _localized(url: str, path: Path) -> httpx2.Response:
    with path.open("rb") as audio:
        answer = httpx2.post(
            f"{url}/localize",
            files={"audio": audio},
            data={"array": "respeaker-usb-4mic-v2"},
            timeout=600,
        )
    return answer.raise_for_status()


def write_recording(path: Path, seconds: int) -> None:
    """The sample recording again and again, as 16-bit WAV."""
    audio, _ = soundfile.read(RECORDING, dtype="int16")
    part = np.tile(audio, (PART_S * RATE // len(audio) + 1, 1))[: PART_S * RATE]
    with soundfile.SoundFile(path, "w", RATE, audio.shape[1], "PCM_16") as file:
        for begin in range(0, seconds, PART_S):
            file.write(part[: min(PART_S, seconds - begin) * RATE])


@contextmanager
def watched(pid: int) -> Iterator[list[float]]:
    """Megabytes of a process and its children, several times a second."""
    megabytes = [family_mb(pid)]
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.2):
            megabytes.append(family_mb(pid))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield megabytes
    finally:
        ended.set()
        watcher.join()


def family_mb(pid: int) -> float:
    """Proportional set size of a process and its children."""
    return sum(map(pss_mb, (pid, *children(pid))))


def memory(count: int, seconds: float) -> dict[str, float]:
    """Megabytes that a silent and a streaming session add, service and workers together."""
    with Served("--max-sessions", str(count + 8), "--stream-workers", "1") as served:
        url = served.url.replace("http", "ws") + "/stream"
        asyncio.run(_sessions(served, url, 2, 2.0))  # what the first ones load stays
        time.sleep(1.0)  # what they leave is given back once their sockets are closed
        at_rest = served.footprint().pss_mb
        idle = asyncio.run(_sessions(served, url, count, 0.0))
        active = asyncio.run(_sessions(served, url, count, seconds))
    return {
        "sessions": count,
        "seconds": seconds,
        "idle_mb": round((idle - at_rest) / count, 2),
        "active_mb": round((active - at_rest) / count, 2),
        "at_rest_mb": round(at_rest, 1),
    }


async def _sessions(served: Served, url: str, count: int, seconds: float) -> float:
    """Memory with so many sessions, each of which has sent so much audio."""
    audio, _ = soundfile.read(RECORDING, dtype="int16")
    async with AsyncExitStack() as stack:
        sockets = [await stack.enter_async_context(connect(url, **OPTIONS)) for _ in range(count)]
        for socket in sockets:
            await socket.send(start(INTERVAL_MS))
            await socket.recv()
        began, length = time.monotonic(), RATE * INTERVAL_MS // 1000
        for index in range(round(seconds * RATE / length)):
            place = index * length % (len(audio) - length)
            for socket in sockets:
                await socket.send(audio[place : place + length].tobytes())
            await asyncio.sleep(began + (index + 1) * length / RATE - time.monotonic())
        await asyncio.sleep(1.0)
        return served.footprint().pss_mb


def main() -> None:
    """Measure, print and, if asked, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="folder of performance.json and performance.md")
    parser.add_argument("--seconds", type=float, default=30.0, help="of every fleet")
    parser.add_argument("--repeats", type=int, default=100, help="windows per array")
    parser.add_argument("--hour", type=int, default=3600, help="seconds of the long file")
    asked = parser.parse_args()
    measured = windows(asked.repeats)
    figures = {
        "windows": measured,
        "roofline": roofline(measured["stages_ms"]),
        "cold_start": cold_starts(5),
        "fleets": fleets([1, 10, 20, 40, 50, 60, 70, 80], asked.seconds),
        "files": files([60, asked.hour]),
        "memory": memory(20, 20.0),
    }
    print(tables(figures))
    if asked.out:
        (asked.out / "performance.json").write_text(json.dumps(figures, indent=2) + "\n")
        write_tables(asked.out)


if __name__ == "__main__":
    main()
