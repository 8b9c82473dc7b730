"""Who watches a stream: what is told, listed and exported, and how many may."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from contextlib import AsyncExitStack
from typing import Any

import httpx2
import numpy as np
import pytest
from running_service import RunningService
from websocket_stream import SECOND, opened, started, until

from service.settings import Settings


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    settings = Settings(
        workers=1, stream_workers=1, max_sessions=8, max_sessions_per_client=1, idle_timeout_s=20
    )
    running = RunningService(settings=settings)
    yield running
    running.stop()


def sessions(service: RunningService) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = httpx2.get(f"{service.url}/sessions").json()["sessions"]
    return found


def test_who_watches_late_is_told_what_was_warned_of(service: RunningService) -> None:
    silent = np.frombuffer(SECOND, "<i2").reshape(-1, 4).copy()
    silent[:, 2] = 0

    async def run() -> tuple[dict[str, Any], dict[str, Any]]:
        async with opened(service) as socket, httpx2.AsyncClient(base_url=service.url) as http:
            ready = await started(socket, overflow="block")
            for _ in range(3):
                for begin in range(0, len(silent), 4000):
                    await socket.send(silent[begin : begin + 4000].tobytes())
            warned = await until(socket, "warning")
            async with http.stream("GET", f"/sessions/{ready['session']}/events") as response:
                lines = response.aiter_lines()
                while await anext(lines) != "event: warning":
                    pass
                return warned, json.loads((await anext(lines)).removeprefix("data: "))

    warned, told = asyncio.run(run())
    assert (told["code"], told["channels"]) == ("channel_dead", [2])
    assert told == warned


def test_a_session_can_be_watched_listed_and_exported(service: RunningService) -> None:
    async def run() -> tuple[list[tuple[str, Any]], dict[str, Any], str, str]:
        async with opened(service) as socket, httpx2.AsyncClient(base_url=service.url) as http:
            ready = await started(socket, client="watched")
            await socket.send(SECOND[:65_536])
            await until(socket, "result")
            path = f"/sessions/{ready['session']}"
            events: list[tuple[str, Any]] = []
            async with http.stream("GET", f"{path}/events") as response:
                assert response.headers["content-type"].startswith("text/event-stream")
                lines = response.aiter_lines()
                await socket.send(SECOND[:65_536])
                await socket.send('{"type":"stop"}')
                kind = ""
                async for line in lines:
                    if line.startswith("event: "):
                        kind = line.removeprefix("event: ")
                    if line.startswith("data: "):
                        events.append((kind, json.loads(line.removeprefix("data: "))))
            (listed,) = (s for s in sessions(service) if s["id"] == ready["session"])
            lines_text = (await http.get(f"{path}/export")).text
            table = (await http.get(f"{path}/export", params={"format": "csv"})).text
            return events, listed, lines_text, table

    events, listed, lines, table = asyncio.run(run())
    kinds = [kind for kind, _ in events]
    assert kinds[:2] == ["ready", "history"]
    assert kinds[-2:] == ["summary", "closing"]
    assert all(len(data["spectrum"]) == 360 for kind, data in events if kind == "result")
    assert (listed["client"], listed["state"], listed["method"]) == (
        "watched",
        "ended",
        "norm_music",
    )
    assert len(lines.splitlines()) == listed["results"]
    assert json.loads(lines.splitlines()[0])["t_end"] == pytest.approx(0.1)
    assert table.startswith("t_end,capture_time_ns,id,azimuth_deg,elevation_deg,confidence,active")


def test_watchers_have_a_limit_and_give_their_places_back(
    service: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.access.keys.MAX_WATCHERS", 2)
    monkeypatch.setattr("service.streaming.registry.MAX_WATCHERS", 3)

    async def run() -> list[tuple[int, str]]:
        async with opened(service) as socket, httpx2.AsyncClient(base_url=service.url) as http:
            path = f"/sessions/{(await started(socket))['session']}/events"

            async def refusal() -> tuple[int, str]:
                answer = await http.get(path)
                return answer.status_code, answer.json()["code"]

            async with AsyncExitStack() as watching:
                for _ in range(2):
                    await watching.enter_async_context(http.stream("GET", path))
                refused = [await refusal()]
                monkeypatch.setattr("service.access.keys.MAX_WATCHERS", 9)
                await watching.enter_async_context(http.stream("GET", path))
                refused.append(await refusal())
            monkeypatch.setattr("service.access.keys.MAX_WATCHERS", 1)
            for _ in range(1000):  # the service notices that they are gone
                async with http.stream("GET", path) as again:
                    if again.status_code == 200:
                        return refused
            raise AssertionError("places were not given back")

    assert asyncio.run(run()) == [(429, "too_many_watchers"), (503, "overloaded")]


def test_an_unknown_session_is_a_404_problem(service: RunningService) -> None:
    for path in ("events", "export"):
        response = httpx2.get(f"{service.url}/sessions/nobody/{path}")
        assert (response.status_code, response.json()["code"]) == (404, "not_found")
