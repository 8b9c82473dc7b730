"""Two replicas that know each other: whichever is asked answers for both."""

from __future__ import annotations

import asyncio
import csv
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import httpx2
import pytest
from running_service import RunningService
from websocket_stream import PATIENCE, SECOND, opened, started, until
from websockets.asyncio.client import ClientConnection

from service.access.key_file import Key, new_token, token_sha256
from service.settings import Settings

TOKEN = new_token()
KEY = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture(scope="module")
def replicas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[RunningService]]:
    keys = tmp_path_factory.mktemp("keys") / "keys.jsonl"
    key = Key(name="all", sha256=token_sha256(TOKEN), roles=("stream", "watch"))
    keys.write_text(key.line)
    keys.chmod(0o600)
    with ExitStack() as held:
        places = [held.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2)]
        ports = [place.getsockname()[1] for place in places]
    peers = tuple(("localhost", port) for port in ports)
    running = [
        RunningService(port, Settings(workers=1, stream_workers=1, keys=keys, peers=peers))
        for port in ports
    ]
    yield running
    for each in running:
        each.stop()


async def speak(robot: ClientConnection) -> None:
    """A second of noise, in messages of 100 ms."""
    size = len(SECOND) // 10
    for begin in range(0, len(SECOND), size):
        await robot.send(SECOND[begin : begin + size])


def listed(service: RunningService, **params: str) -> Any:
    return httpx2.get(f"{service.url}/sessions", params=params, headers=KEY).json()


def test_a_stream_is_listed_watched_and_exported_from_the_other_replica(
    replicas: list[RunningService],
) -> None:
    here, there = replicas

    async def scenario() -> None:
        async with opened(here, additional_headers=KEY) as robot, httpx2.AsyncClient() as http:
            ident = (await started(robot, client="robot-7"))["session"]
            await speak(robot)
            await until(robot, "result")
            both = await asyncio.to_thread(listed, there)
            (session,) = both["sessions"]
            assert (session["id"], session["client"]) == (ident, "robot-7")
            assert session["replica"] == here.state.replicas.name
            assert both["replica"] == there.state.replicas.name
            assert set(both["replicas"]) == {session["replica"], both["replica"]}
            assert both["max_sessions"] == 2 * here.state.streams.max_sessions
            assert both["unanswered"] == 0
            assert (await asyncio.to_thread(listed, there, replicas="one"))["sessions"] == []

            events = f"{there.url}/sessions/{ident}/events"
            async with http.stream("GET", events, headers=KEY, timeout=PATIENCE) as response:
                assert response.headers["content-type"].startswith("text/event-stream")
                lines = response.aiter_lines()
                assert await anext(lines) == "event: ready"
                await speak(robot)
                while await anext(lines) != "event: result":
                    pass
                result = json.loads((await anext(lines)).removeprefix("data: "))
                assert len(result["spectrum"]) == 360

            export = f"{there.url}/sessions/{ident}/export"
            answered = await http.get(export, params={"format": "csv"}, headers=KEY)
            named = f'attachment; filename="session-{ident}.csv"'
            assert answered.headers["content-disposition"] == named
            assert next(csv.reader(answered.text.splitlines()))[0] == "t_end"

    asyncio.run(scenario())


@pytest.mark.parametrize("ident", ["nobody", "a%20b", "a%0d%0aX:%20y", "..%2f..%2fadmin"])
def test_a_session_that_no_replica_has_is_not_found(
    replicas: list[RunningService], ident: str
) -> None:
    answer = httpx2.get(f"{replicas[0].url}/sessions/{ident}/events", headers=KEY)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_a_stranger_gets_nothing_by_way_of_another_replica(
    replicas: list[RunningService],
) -> None:
    assert httpx2.get(f"{replicas[0].url}/sessions").status_code == 401


def test_a_watcher_by_way_of_another_replica_is_told_when_that_one_stops(
    replicas: list[RunningService],
) -> None:
    here, there = replicas

    async def scenario() -> None:
        async with opened(here, additional_headers=KEY) as robot, httpx2.AsyncClient() as http:
            ident = (await started(robot))["session"]
            events = f"{there.url}/sessions/{ident}/events"
            async with http.stream("GET", events, headers=KEY, timeout=PATIENCE) as response:
                pieces = response.aiter_bytes()
                await anext(pieces)
                there.begin_stop()
                async for _ in pieces:
                    pass

    asyncio.run(scenario())
    there.stop()
    alone = listed(here)
    assert (alone["replicas"], alone["unanswered"]) == ([here.state.replicas.name], 1)
