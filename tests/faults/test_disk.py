"""The disk is full: where uploads are spooled, and where noise profiles are kept."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx2
import pytest
from bench.fleet import ARRAY, RECORDING, Robot, fleet, recording, until
from bench.served import Served

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(os.geteuid() != 0, reason="a small file system needs root"),
]

ROBOTS = 3


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of one megabyte."""
    place = tmp_path / "disk"
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", place], check=True)
    yield place
    subprocess.run(["umount", "--lazy", place], check=True)


def grow(disk: Path) -> None:
    """Free space on the file system."""
    subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)


def spooled(disk: Path) -> list[str]:
    """The files on it, without onnxruntime's in the temporary folder."""
    return [path.name for path in disk.iterdir() if path.name != ".ses"]


def post(service: Served, audio: bytes, form: bool) -> httpx2.Response:
    if form:
        files: Any = {"audio": audio}
        return httpx2.post(
            f"{service.url}/localize", data={"array": ARRAY}, files=files, timeout=60
        )
    return httpx2.post(
        f"{service.url}/localize?array={ARRAY}",
        content=audio,
        headers={"Content-Type": "audio/wav"},
        timeout=60,
    )


def test_disk_full_of_uploads(figures: Callable[..., None], disk: Path) -> None:
    large, small = recording(8), RECORDING.read_bytes()

    async def scenario(service: Served) -> tuple[list[Robot], list[httpx2.Response], float]:
        async with fleet(service.url, ROBOTS) as robots:
            answers, began = [], time.monotonic()
            for form in (True, False):
                for audio in (large, small):
                    answers.append(await asyncio.to_thread(post, service, audio, form))
            assert spooled(disk) == []
            grow(disk)
            answers.append(await asyncio.to_thread(post, service, large, True))
            moment = time.monotonic()
            await until(
                lambda: all(sum(h.arrived > moment for h in r.heard) >= 5 for r in robots),
                "robots hear",
            )
            lost_s = sum(robot.lost_s(began) for robot in robots)
            return robots, answers, lost_s

    with Served(environment={"TMPDIR": str(disk)}) as service:
        robots, answers, lost_s = asyncio.run(scenario(service))
        assert spooled(disk) == []
        assert "Traceback" not in service.log
    refused, passed, refused_raw, passed_raw, later = answers
    figures(
        f"Uploads of {len(large) / 1e6:.1f} MB with 1 MB of disk, {ROBOTS} robots beside it",
        large=f"{refused.status_code} `{refused.json()['code']}`, "
        f"Retry-After {refused.headers.get('Retry-After')}",
        small=f"{passed.status_code} meanwhile",
        large_again=f"{later.status_code} once there is room",
        files_left="0",
        streams=f"{sum(robot.cut for robot in robots)} cut, {lost_s:.1f} s lost",
    )
    for answer in (refused, refused_raw):
        assert (answer.status_code, answer.json()["code"]) == (503, "disk_full")
        assert "no room" in answer.json()["detail"]
        assert "Retry-After" in answer.headers
    assert passed.status_code == passed_raw.status_code == later.status_code == 200
    assert all(robot.cut == 0 for robot in robots)


def test_uploads_that_fill_the_disk_and_drip(figures: Callable[..., None], disk: Path) -> None:
    """They are slow enough for the deadline of a body, and would hold the disk for hours."""
    over = threading.Event()
    head = f"POST /localize?array={ARRAY} HTTP/1.1\r\nHost: x\r\nContent-Type: audio/wav\r\n"
    body = 12 * 2**20

    def drip(connection: socket.socket) -> None:
        connection.sendall(f"{head}Content-Length: {body}\r\n\r\n".encode() + bytes(body - 2**20))
        with suppress(OSError):  # the service closed the connection
            while not over.wait(0.5):
                connection.sendall(bytes(500))

    subprocess.run(["mount", "-o", "remount,size=24m", disk], check=True)
    with Served(environment={"TMPDIR": str(disk)}) as service, ExitStack() as held:
        held.callback(over.set)
        for _ in range(2):
            connection = socket.create_connection(("127.0.0.1", service.port))
            held.enter_context(connection)
            threading.Thread(target=drip, args=(connection,)).start()
        audio, began, codes = recording(4), time.monotonic(), [0]
        while codes[-1] != 200 and time.monotonic() - began < 60:
            codes.append(post(service, audio, False).status_code)
        waited = time.monotonic() - began
        assert "Traceback" not in service.log
    figures(
        "Two uploads that fill the disk and then send 1,000 bytes a second",
        others=f"503 `disk_full` for {waited:.0f} s, then 200",
    )
    assert codes[-1] == 200
    assert waited < 30


def test_disk_full_of_noise_profiles(figures: Callable[..., None], disk: Path) -> None:
    async def calibrated(service: Served) -> Robot:
        async with fleet(service.url, 1, client="robot") as (robot,):
            assert robot.stream is not None
            robot.stream.calibrate(1.0)
            await until(lambda: bool(robot.calibrated), "it is calibrated")
            return robot

    with Served("--noise-folder", str(disk / "noise")) as service:
        (disk / "filler").write_bytes(bytes(2**20 - 2**13))
        full = asyncio.run(calibrated(service))
        (disk / "filler").unlink()
        roomy = asyncio.run(calibrated(service))
        profile = httpx2.get(f"{service.url}/noise/robot").content
        (disk / "filler").write_bytes(bytes(2**20 - 2**14 - len(profile)))
        put = httpx2.put(f"{service.url}/noise/another", content=profile)
        known = [each["name"] for each in service.get("/noise")["noise"]]
        kept = sorted(path.name for path in (disk / "noise").iterdir())
        assert "Traceback" not in service.log
    told = [warning.code for warning in full.warnings]
    figures(
        "A noise calibration with a full disk under the noise folder",
        stream="`calibration_failed`, the noise is used for this stream" if told else "nothing",
        with_room=f"kept as {roomy.calibrated[0].name}",
        put=f"{put.status_code} `{put.json().get('code')}`",
        files=", ".join(kept),
    )
    assert "calibration_failed" in told
    assert full.calibrated[0].name is None
    assert not full.cut
    assert roomy.calibrated[0].name == "robot"
    assert (put.status_code, put.json()["code"]) == (503, "disk_full")
    assert known == ["robot"]
    assert kept == ["robot.npz"]
