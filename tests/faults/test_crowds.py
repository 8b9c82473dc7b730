"""More connections than there are files: idle ones, and uploads that never end."""

from __future__ import annotations

import asyncio
import resource
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack

import httpx2
import numpy as np
import pytest
from bench.fleet import RECORDING, fleet, until
from bench.requests_by_hand import BODY, HEAD
from bench.served import Served

pytestmark = pytest.mark.faults

IDLE = 5000
FILES = 1024
FEW_FILES = 64
UPLOADS = 200
ANSWER_S = 0.5
"""Seconds without a word, after which an upload is being read"""
ROBOTS = 2
MOST_LAG_MS = 250


@pytest.fixture
def many_files() -> None:
    """The test's own limit, for its ends of the connections."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 2 * IDLE:
        pytest.skip(f"{hard} files may be open, and the test needs {2 * IDLE}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2 * IDLE), hard))


def limited(files: int) -> tuple[str, ...]:
    return ("sh", "-c", f'ulimit -n {files}; exec "$@"', "sh")


@pytest.mark.usefixtures("many_files")
def test_idle_connections(figures: Callable[..., None]) -> None:
    async def scenario(service: Served) -> tuple[list[float], float, int, float]:
        async with fleet(service.url, ROBOTS) as robots:
            began = time.monotonic()
            with ExitStack() as opened:
                for _ in range(IDLE // 100):
                    for _ in range(100):
                        idle = opened.enter_context(socket.socket())
                        idle.setblocking(False)
                        idle.connect_ex(("127.0.0.1", service.port))
                    await asyncio.sleep(0.02)
                asked = time.monotonic()
                answer = await asyncio.to_thread(
                    httpx2.get, f"{service.url}/readyz", timeout=10, trust_env=False
                )
                answered_s = time.monotonic() - asked
                await until(lambda: all(len(r.lags_ms(asked)) > 20 for r in robots), "robots hear")
            lags = [lag for robot in robots for lag in robot.lags_ms(began)]
            assert all(robot.cut == 0 for robot in robots)
            lost_s = max(robot.lost_s(began) for robot in robots)
            return lags, lost_s, answer.status_code, answered_s

    with Served("--stream-workers", "1", "--workers", "1", within=limited(FILES)) as service:
        lags, lost_s, status, answered_s = asyncio.run(scenario(service))
        lines = len(service.log.splitlines())
    p99 = np.percentile(lags, 99)
    figures(
        f"{IDLE} idle connections where {FILES} files may be open, {ROBOTS} robots beside them",
        others=f"{lost_s:.1f} s lost, lag p99 {p99:.0f} ms",
        readyz=f"{status} after {answered_s:.1f} s",
        log=f"{lines} lines",
    )
    assert status == 200
    assert lost_s == 0
    assert p99 < MOST_LAG_MS
    assert lines < 10


async def upload(port: int, request: bytes) -> bytes:
    """What one upload is answered."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    try:
        return await reader.read()
    finally:
        writer.close()


def test_uploads_at_once(figures: Callable[..., None]) -> None:
    audio = RECORDING.read_bytes()
    request = HEAD + b"Connection: close\r\nContent-Type: audio/flac\r\nContent-Length: %d\r\n\r\n"
    request = request % len(audio) + audio

    async def crowd(port: int) -> list[bytes]:
        return await asyncio.gather(*(upload(port, request) for _ in range(UPLOADS)))

    async def scenario(service: Served) -> tuple[list[bytes], float, list[float]]:
        async with fleet(service.url, ROBOTS) as robots:
            began = time.monotonic()
            answers = await asyncio.to_thread(lambda: asyncio.run(crowd(service.port)))
            assert all(robot.cut == 0 for robot in robots)
            lags = [lag for robot in robots for lag in robot.lags_ms(began)]
            return answers, max(robot.lost_s(began) for robot in robots), lags

    with Served("--stream-workers", "1") as service:
        answers, lost_s, lags = asyncio.run(scenario(service))
        again = asyncio.run(upload(service.port, request))
        log = service.log
    statuses = Counter(each[9:12].decode() for each in answers)
    p99 = np.percentile(lags, 99)
    figures(
        f"{UPLOADS} uploads at once, {ROBOTS} robots beside them",
        answers=dict(statuses),
        others=f"{lost_s:.1f} s lost, lag p99 {p99:.0f} ms",
    )
    assert set(statuses) == {"200", "503"}
    refused = [each for each in answers if each.startswith(b"HTTP/1.1 503 ")]
    assert all(b'"code":"overloaded"' in each for each in refused)
    assert all(b"retry-after: " in each for each in refused)
    assert again.startswith(b"HTTP/1.1 200 ")
    assert lost_s == 0
    assert p99 < MOST_LAG_MS
    assert "Traceback" not in log


def test_uploads_beyond_the_files(figures: Callable[..., None]) -> None:
    with Served("--workers", "1", within=limited(FEW_FILES)) as service, ExitStack() as opened:
        answers: Counter[str] = Counter()
        for _ in range(FEW_FILES):
            upload = opened.enter_context(
                socket.create_connection(("127.0.0.1", service.port), timeout=ANSWER_S)
            )
            upload.sendall(BODY + bytes(1000))
            try:
                said = upload.recv(4096)
            except TimeoutError:
                answers["still read"] += 1
            else:
                answers[said[9:12].decode()] += 1
                assert b'"code":"too_many_connections"' in said
        opened.close()
        afterwards = httpx2.get(f"{service.url}/readyz", timeout=10, trust_env=False)
        log = service.log
    figures(
        f"{FEW_FILES} uploads at once where {FEW_FILES} files may be open",
        answers=dict(answers),
        log=f"{len(log.splitlines())} lines",
    )
    assert set(answers) == {"still read", "503"}
    assert afterwards.status_code == 200
    assert "Traceback" not in log
    assert len(log.splitlines()) < 10
