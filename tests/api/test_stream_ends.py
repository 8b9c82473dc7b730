"""Streams whose worker dies or whose service stops, and the memory that streams leave."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
import websockets
from running_service import RunningService
from websocket_stream import PATIENCE, SECOND, end, opened, started, until

from service.api import state
from service.settings import Settings


@pytest.fixture
def given_back() -> Iterator[threading.Event]:
    """Set when the service gives memory back; it looks every 20 ms."""
    given = threading.Event()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(state, "TEND_S", 0.02)
        patched.setattr(state, "give_back_memory", given.set)
        yield given


@pytest.fixture
def service(given_back: threading.Event) -> Iterator[RunningService]:
    running = RunningService(settings=Settings(workers=1, stream_workers=1), workers_ahead=True)
    yield running
    running.stop()


def test_streams_of_a_worker_that_dies_are_closed_and_the_next_ones_run(
    service: RunningService, given_back: threading.Event
) -> None:
    async def run() -> tuple[dict[str, Any], int | None, dict[str, Any]]:
        async with opened(service) as first:
            await started(first)
            (pid,) = service.worker_pids
            os.kill(pid, signal.SIGKILL)
            await first.send(SECOND[:65_536])
            last, close_code = await end(first)
        async with opened(service) as second:
            await started(second)
            given_back.clear()
            await second.send(SECOND[:65_536])
            assert not given_back.is_set()
            return last, close_code, await until(second, "result")

    last, close_code, result = asyncio.run(run())
    assert (last["code"], last["retryable"], close_code) == ("worker_lost", True, 1011)
    assert result["t_end"] == pytest.approx(0.1)
    assert given_back.wait(PATIENCE)


def test_a_stopping_service_says_goodbye_takes_nobody_new_and_ends_its_workers(
    service: RunningService,
) -> None:
    (pid,) = service.worker_pids

    async def run() -> tuple[list[str], dict[str, Any], int | None]:
        async with opened(service) as socket:
            await started(socket)
            await socket.send(SECOND[:40_000])
            stopping = asyncio.create_task(asyncio.to_thread(service.stop))
            kinds, last = [], {}
            with suppress(websockets.ConnectionClosedError):
                async for text in socket:
                    last = json.loads(text)
                    kinds.append(last["type"])
            await stopping
            return kinds, last, socket.close_code

    kinds, closing, close_code = asyncio.run(run())
    assert kinds[-2:] == ["summary", "closing"]
    assert (closing["code"], close_code) == ("draining", 1012)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
