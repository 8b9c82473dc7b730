"""File systems that cannot be written, and a system without ``/dev/shm``."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Callable

import httpx2
import pytest
from bench.fleet import ARRAY, RECORDING, Robot, fleet, recording, until
from bench.served import Served

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(
        os.geteuid() != 0 or not shutil.which("unshare"), reason="mounts of its own need root"
    ),
]

READ_ONLY = """
mount --make-rprivate /
awk '{print $2}' /proc/mounts | while read each; do mount -o remount,bind,ro "$each"; done 2>&-
exec "$@"
"""
NO_SEMAPHORES = """
mount --make-rprivate /
mount -t tmpfs -o ro none /dev/shm
exec "$@"
"""


def mounted(script: str) -> tuple[str, ...]:
    return ("unshare", "--mount", "sh", "-c", script, "sh")


def post(service: Served, audio: bytes) -> httpx2.Response:
    return httpx2.post(
        f"{service.url}/localize", data={"array": ARRAY}, files={"audio": audio}, timeout=60
    )


async def calibrated(service: Served) -> Robot:
    """A robot that has results and has learnt its noise."""
    async with fleet(service.url, 1, client="robot") as (robot,):
        assert robot.stream is not None
        robot.stream.calibrate(1.0)
        await until(lambda: bool(robot.calibrated), "it is calibrated")
        return robot


def test_nothing_can_be_written(figures: Callable[..., None]) -> None:
    with Served("--noise-folder", "/nowhere/noise", within=mounted(READ_ONLY)) as service:
        robot = asyncio.run(calibrated(service))
        answers = [post(service, RECORDING.read_bytes()) for _ in range(20)]
        ready = httpx2.get(f"{service.url}/readyz").status_code
        reloaded = httpx2.post(f"{service.url}/admin/reload", timeout=60).status_code
        lines = [line for line in service.log.splitlines() if "cannot be stored" in line]
        log = service.log
    figures(
        "`neuralmusic serve` where every file system is read-only",
        streams=f"results as ever, {robot.cut} cut; noise used, not stored",
        uploads=f"{answers[0].status_code} `{answers[0].json()['code']}`",
        log=f"{len(lines)} lines: “{lines[-1].split('  ')[1].partition(': ')[2][:60]}”",
        readyz=ready,
        reload=reloaded,
    )
    assert not robot.cut
    assert robot.calibrated[0].name is None
    assert {(each.status_code, each.json()["code"]) for each in answers} == {(503, "disk_full")}
    assert "log says why" in answers[0].json()["detail"]
    assert len(lines) == 2  # of the calibration, and one for all uploads
    assert all("Read-only file system" in line or "directory" in line for line in lines)
    assert (ready, reloaded) == (200, 200)
    assert "Traceback" not in log


def test_there_is_no_dev_shm(figures: Callable[..., None]) -> None:
    """Processes that share a recording need semaphores."""
    flags = ("--workers", "1", "--processes", "2")
    with Served(*flags, within=mounted(NO_SEMAPHORES)) as service:
        answer = post(service, recording(4))
        robot = asyncio.run(calibrated(service))
        log = service.log
    figures(
        "No `/dev/shm`, recordings by two processes each",
        recording=f"{answer.status_code}, by one process",
        streams=f"{robot.cut} cut",
    )
    assert answer.status_code == 200
    assert not robot.cut
    assert "/dev/shm" in log
    assert "Traceback" not in log
