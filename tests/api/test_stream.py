"""``/stream`` over a real socket: handshake, close codes, hostile clients, draining."""

from __future__ import annotations

import asyncio
import gc
import json
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import httpx2
import numpy as np
import pytest
import websockets
from running_service import RunningService
from websocket_stream import PATIENCE, SECOND, START, end, opened, refusal, started, until

from neuralmusic.errors import UnknownNoise
from service.api import stream as stream_api
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.settings import Settings
from service.streaming.session import Session


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    settings = Settings(
        workers=1, stream_workers=1, max_sessions=8, max_sessions_per_client=1, idle_timeout_s=20
    )
    running = RunningService(settings=settings)
    yield running
    running.stop()


def test_a_handshake_without_the_subprotocol_is_a_problem_and_no_error_of_the_server(
    service: RunningService, caplog: pytest.LogCaptureFixture
) -> None:
    status, problem, headers = refusal(service, subprotocols=None)
    assert not caplog.records
    assert (status, problem["code"]) == (400, "subprotocol_missing")
    assert headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["/streams", "/stream/", "/localize", "/"])
def test_a_websocket_at_a_wrong_path_is_a_problem_that_names_the_right_one(
    service: RunningService, path: str
) -> None:
    status, problem, headers = refusal(service, path=path)
    assert (status, problem["code"]) == (404, "not_found")
    assert problem["detail"] == f"there is no WebSocket at {path}: streams are at /stream"
    assert headers["content-type"] == "application/problem+json"


def test_a_request_to_the_stream_s_path_is_told_that_it_is_a_websocket(
    service: RunningService,
) -> None:
    answer = httpx2.get(f"{service.url}/stream")
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    assert "/stream is a WebSocket" in answer.json()["detail"]


def test_a_page_from_elsewhere_is_refused_and_the_own_page_is_not(service: RunningService) -> None:
    status, problem, _ = refusal(service, origin="http://evil.example")
    assert (status, problem["code"]) == (403, "origin_refused")

    async def own() -> str:
        async with opened(service, origin=service.url) as socket:
            return (await started(socket))["session"]

    assert asyncio.run(own())


def test_who_sends_pings_without_end_is_told_and_closed(service: RunningService) -> None:
    async def flood() -> tuple[dict[str, Any], int | None]:
        async with opened(service) as socket:
            await started(socket)
            with suppress(websockets.ConnectionClosed):
                for _ in range(2000):
                    await socket.ping()
            return await end(socket)

    last, code = asyncio.run(flood())
    assert (last["type"], last["code"], code) == ("error", "too_many_frames", 1008)


def test_a_full_service_says_when_to_come_again(service: RunningService) -> None:
    async def fill() -> tuple[int, dict[str, Any], Any]:
        async with asyncio.TaskGroup() as group:
            release = asyncio.Event()

            async def hold(ready: asyncio.Event) -> None:
                async with opened(service) as socket:
                    await started(socket)
                    ready.set()
                    await release.wait()

            for _ in range(8):
                ready = asyncio.Event()
                group.create_task(hold(ready))
                await ready.wait()
            found = await asyncio.to_thread(refusal, service)
            release.set()
        return found

    status, problem, headers = asyncio.run(fill())
    assert (status, problem["code"]) == (503, "overloaded")
    assert int(headers["retry-after"]) > 0


@pytest.mark.parametrize(
    ("messages", "code", "close_code"),
    [
        ([bytes(8)], "audio_before_start", 1003),
        (["{"], "message_invalid", 4400),
        ([json.dumps(START), bytes(7)], "message_invalid", 4400),
        ([json.dumps(START), b"RIFF" + bytes(60)], "message_invalid", 4400),
        ([json.dumps(START), bytes(270_000)], "message_too_big", 1009),
        ([" " * 70_000], "message_too_big", 1009),
        (['{"type":"stop"}'], "done", 1000),
    ],
)
def test_a_message_precedes_every_close_frame(
    messages: list[str | bytes], code: str, close_code: int, service: RunningService
) -> None:
    async def run() -> tuple[dict[str, Any], int | None]:
        async with opened(service) as socket:
            for message in messages:
                await socket.send(message)
            return await end(socket)

    last, closed_with = asyncio.run(run())
    assert (last["code"], closed_with) == (code, close_code)


def test_one_client_name_has_a_bounded_number_of_streams(service: RunningService) -> None:
    async def run() -> tuple[dict[str, Any], int | None]:
        async with opened(service) as first, opened(service) as second:
            await started(first, client="robot")
            await second.send(json.dumps({**START, "client": "robot"}))
            return await end(second)

    last, close_code = asyncio.run(run())
    assert (last["code"], close_code) == ("too_many_sessions", 4429)


def test_others_do_not_notice_one_who_floods_one_who_vanishes_and_one_who_never_reads(
    service: RunningService,
) -> None:
    async def flood() -> None:
        async with opened(service) as socket:
            await started(socket)
            for _ in range(150):
                await socket.send(SECOND[:65_536])

    async def vanish() -> None:
        async with opened(service) as socket:
            await started(socket)
            await socket.send(SECOND[:65_536])
            socket.transport.abort()

    async def never_read(finished: asyncio.Event) -> None:
        async with opened(service) as socket:
            await started(socket, output={"include": ["spectrum"], "interval_ms": 20})
            socket.transport.pause_reading()
            await socket.send(SECOND[:65_536])
            await finished.wait()
            socket.transport.abort()

    async def robot() -> list[dict[str, Any]]:
        async with opened(service) as socket:
            await started(socket, overflow="block")
            for index in range(20):
                await socket.send(SECOND[index * 6400 : (index + 1) * 6400])
            return [await until(socket, "result") for _ in range(10)]

    async def run() -> list[dict[str, Any]]:
        finished = asyncio.Event()
        async with asyncio.TaskGroup() as group:
            for each in (flood(), vanish(), never_read(finished)):
                group.create_task(each)
            results = await robot()
            finished.set()
        return results

    results = asyncio.run(run())
    assert [round(r["t_end"], 3) for r in results] == pytest.approx(np.arange(1, 11) / 10)
    settle(service)


@pytest.mark.parametrize(
    "step", ["receive_text", "receive_bytes", "take_work", "work_done", "tick"]
)
def test_a_session_whose_own_code_raises_is_told_and_ends_alone(
    service: RunningService,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    step: str,
) -> None:
    sound = getattr(Session, step)

    def broken(session: Session, *args: Any) -> Any:
        if session.start is not None and session.start.client == "broken":
            raise ArithmeticError("a defect")
        return sound(session, *args)

    async def run() -> tuple[dict[str, Any], int | None, str, dict[str, Any]]:
        async with opened(service) as other, opened(service) as socket:
            await started(other)
            ident = (await started(socket, client="broken"))["session"]
            monkeypatch.setattr(Session, step, broken)
            await socket.send(SECOND[:65_536])
            await socket.send('{"type":"ping"}')
            last, close_code = await end(socket)
            await other.send(SECOND[:65_536])
            return last, close_code, ident, await until(other, "result")

    monkeypatch.setattr(stream_api, "TICK_S", 0.05)
    last, close_code, ident, result = asyncio.run(run())
    assert (last["type"], last["code"], close_code) == ("error", "internal", 1011)
    assert "defect" not in last["detail"]
    assert result["t_end"] == pytest.approx(0.1)
    (line,) = (record for record in caplog.records if record.exc_info)
    assert vars(line)["session_id"] == ident
    settle(service)


class Deaf:
    """A WebSocket whose client sends and never reads."""

    def __init__(self) -> None:
        self.sent = False
        self.closed = False

    async def receive(self) -> dict[str, Any]:
        if self.sent:
            await asyncio.Event().wait()
        self.sent = True
        return {"type": "websocket.receive", "text": '{"type":"ping"}'}

    async def accept(self, subprotocol: str) -> None:
        assert subprotocol == "doa.v1"

    async def send_text(self, text: str) -> None:
        await asyncio.Event().wait()

    async def close(self, code: int) -> None:
        self.closed = True


def test_a_client_that_never_reads_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_api, "SEND_TIMEOUT_S", 0.05)
    state = create_app(Settings(), BundleRegistry(())).state.service
    deaf = Deaf()

    async def run() -> None:
        async with asyncio.timeout(PATIENCE):
            await stream_api.Connection(deaf, state).run()  # type: ignore[arg-type]
        await state.stream_workers.stop()

    asyncio.run(run())
    assert deaf.closed
    assert state.streams.running == 0
    assert 'sessions_ended_total{reason="timeout"} 1.0' in state.metrics.exposition("")[0].decode()


def settle(service: RunningService) -> None:
    """Wait until no session runs."""

    deadline = time.monotonic() + PATIENCE
    while any(each["state"] == "running" for each in sessions(service)):
        assert time.monotonic() < deadline


def sessions(service: RunningService) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = httpx2.get(f"{service.url}/sessions").json()["sessions"]
    return found


def test_hundreds_who_connect_and_vanish_leave_nothing_behind(service: RunningService) -> None:
    threads = threading.active_count()

    async def run() -> None:
        for index in range(300):
            async with opened(service) as socket:
                if index % 3:
                    await socket.send(json.dumps(START))
                if index % 3 == 2:
                    await socket.send(SECOND[:6400])
                socket.transport.abort()

    asyncio.run(run())
    settle(service)
    assert threading.active_count() <= threads + 1


def test_a_stream_that_ended_keeps_results_and_no_connection(service: RunningService) -> None:
    async def run() -> str:
        async with opened(service) as socket:
            ready = await started(socket)
            await socket.send(SECOND[:65_536])
            await until(socket, "result")
            return str(ready["session"])

    ident = asyncio.run(run())
    settle(service)
    rows = httpx2.get(f"{service.url}/sessions/{ident}/export?format=jsonl").text.splitlines()
    assert json.loads(rows[0])["t_end"] == pytest.approx(0.1)
    deadline = time.monotonic() + PATIENCE
    while any(type(each) is stream_api.Connection for each in gc.get_objects()):
        assert time.monotonic() < deadline
        gc.collect()


def test_a_store_that_waits_for_its_disk_holds_up_nobody_else(
    service: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    reached, go_on = threading.Event(), threading.Event()

    def waiting(name: str) -> Any:
        reached.set()
        assert go_on.wait(PATIENCE)
        raise UnknownNoise(name)

    monkeypatch.setattr(service.state.noise, "get", waiting)

    async def run() -> None:
        async with opened(service) as named, opened(service) as other:
            await named.send(json.dumps({**START, "client": "named"}))
            assert await asyncio.to_thread(reached.wait, PATIENCE)
            await started(other)
            go_on.set()
            await until(named, "ready")

    try:
        asyncio.run(run())
    finally:
        go_on.set()
