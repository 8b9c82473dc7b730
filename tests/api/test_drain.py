"""SIGTERM: load balancers learn first, work that still comes is done, streams are told."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx2
import pytest
from running_service import RunningService
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import ClientConnection, connect

from service.settings import Settings

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[2]
PATIENCE = 30
ARRAY = "respeaker-usb-4mic-v2"
START = {
    "type": "start",
    "audio": {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4},
    "array": {"name": ARRAY},
}


def wait_until_unready(url: str) -> dict[str, str]:
    """The problem that /readyz gives once it gives one."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        answer = httpx2.get(f"{url}/readyz")
        if answer.status_code != 200:
            problem: dict[str, str] = answer.json()
            return problem
    raise AssertionError("the service stays ready")


def until_closed(stream: ClientConnection) -> Iterator[str | bytes]:
    """Every message until the service closes the stream."""
    with suppress(ConnectionClosedError):  # any code but 1000
        while True:
            yield stream.recv(PATIENCE)


def test_what_comes_during_the_delay_is_served_and_then_told_that_it_ends() -> None:
    running = RunningService(settings=Settings(workers=1, drain_delay_s=3600))
    running.begin_stop()
    assert wait_until_unready(running.url)["code"] == "draining"

    recording = (ROOT / "examples" / "two-talkers.flac").read_bytes()
    answer = httpx2.post(
        f"{running.url}/localize",
        files={"audio": recording},
        data={"array": ARRAY},
        timeout=PATIENCE,
    )
    assert answer.status_code == 200

    address = running.url.replace("http", "ws") + "/stream"
    with connect(address, subprotocols=["doa.v1"]) as stream:  # type: ignore[list-item]
        stream.send(json.dumps(START))
        assert json.loads(stream.recv(PATIENCE))["type"] == "ready"
        running.end_delay()
        kinds = [json.loads(text)["type"] for text in until_closed(stream)]
    assert kinds[-2:] == ["summary", "closing"]
    assert stream.close_code == 1012
    running.stop()
