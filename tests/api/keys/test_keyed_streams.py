"""A service with keys over a real socket: who may stream, for how long, and who watches."""

from __future__ import annotations

import asyncio
import base64
import json
from contextlib import suppress
from typing import Any

import httpx2
import numpy as np
import pytest
import websockets
from key_file import KeyFile
from running_service import RunningService
from websocket_stream import PATIENCE, START, end, opened, refusal, started

from neuralmusic import LocalizationClient, ServiceProblem, StreamClient
from neuralmusic.client_errors import StreamClosed, StreamRefused
from service.access.key_file import new_token

PIECE = np.random.default_rng(0).integers(-300, 300, (1600, 4)).astype("<i2").tobytes()
"""A tenth of a second"""


def code_of(service: RunningService, **options: Any) -> tuple[int, str]:
    """Status and code of a handshake that is refused."""
    status, problem, _ = refusal(service, **options)
    return status, problem["code"]


def page_key(token: str) -> str:
    return "bearer." + base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")


def test_a_handshake_without_a_good_key_is_a_real_answer(
    service: RunningService, bearer: Any
) -> None:
    status, problem, headers = refusal(service)
    assert (status, problem["code"]) == (401, "key_missing")
    assert headers["www-authenticate"].startswith("Bearer")
    assert headers["content-type"] == "application/problem+json"
    wrong = {"Authorization": f"Bearer {new_token()}"}
    assert code_of(service, additional_headers=wrong) == (401, "key_unknown")
    assert code_of(service, additional_headers=bearer("localize")) == (403, "role_missing")
    offered = ["doa.v1", page_key(new_token())]
    assert code_of(service, subprotocols=offered) == (401, "key_unknown")
    for junk in ("bearer.", "bearer.!!!", "bearer.gICA"):
        assert refusal(service, subprotocols=["doa.v1", junk])[0] == 401


def test_a_key_as_header_or_subprotocol_opens_a_stream(
    service: RunningService, key_file: KeyFile, bearer: Any
) -> None:
    token = key_file.tokens["stream"]

    async def protocol(**options: Any) -> str | None:
        async with asyncio.timeout(PATIENCE), opened(service, **options) as socket:
            await started(socket)
            return socket.subprotocol  # type: ignore[no-any-return]

    assert asyncio.run(protocol(additional_headers=bearer("stream"))) == "doa.v1"
    # Offered first, too: the answer must never repeat the key.
    assert asyncio.run(protocol(subprotocols=[page_key(token), "doa.v1"])) == "doa.v1"


def test_a_keys_origins_are_for_that_key_alone(service: RunningService, bearer: Any) -> None:
    page = "https://dash.example"
    headers = bearer("stream")
    assert code_of(service, origin=page, additional_headers=headers) == (403, "origin_refused")

    async def attempt() -> None:
        headers = bearer("dashboard")
        async with (
            asyncio.timeout(PATIENCE),
            opened(service, origin=page, additional_headers=headers) as socket,
        ):
            await started(socket)

    asyncio.run(attempt())


def test_a_key_has_its_number_of_streams_and_gets_the_place_back(
    service: RunningService, bearer: Any
) -> None:
    headers = bearer("one-stream")

    async def two() -> tuple[int, dict[str, Any], Any]:
        async with (
            asyncio.timeout(PATIENCE),
            opened(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            found = await asyncio.to_thread(refusal, service, additional_headers=headers)
            await socket.send('{"type":"stop"}')
            await end(socket)
            return found

    for _ in range(2):
        status, problem, answer = asyncio.run(two())
        assert (status, problem["code"]) == (429, "too_many_sessions")
        assert int(answer["retry-after"]) >= 1


def test_a_stream_ends_when_its_keys_audio_is_used_up(
    service: RunningService, key_file: KeyFile, bearer: Any
) -> None:
    headers = bearer("two-seconds")

    async def run() -> tuple[dict[str, Any], int | None]:
        async with (
            asyncio.timeout(PATIENCE),
            opened(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            with suppress(websockets.ConnectionClosed):
                for _ in range(30):
                    await socket.send(PIECE)
            return await end(socket)

    last, close_code = asyncio.run(run())
    assert (last["type"], last["code"], close_code) == ("error", "audio_quota", 4429)
    status, problem, answer = refusal(service, additional_headers=headers)
    assert (status, problem["code"]) == (429, "audio_quota")
    assert int(answer["retry-after"]) >= 1


def test_a_stream_whose_key_is_taken_away_is_told_and_closed(
    service: RunningService, key_file: KeyFile
) -> None:
    token = key_file.add("leaving", "stream")
    state = service._app.state.service
    state.keys.reload()

    async def run() -> tuple[dict[str, Any], int | None]:
        headers = {"Authorization": f"Bearer {token}"}
        async with (
            asyncio.timeout(PATIENCE),
            opened(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            key_file.remove("leaving")
            state.keys.reload()
            return await end(socket)

    last, close_code = asyncio.run(run())
    assert (last["type"], last["code"], close_code) == ("error", "key_unknown", 4401)


def test_a_watcher_whose_key_is_taken_away_sees_no_more(
    service: RunningService, key_file: KeyFile, bearer: Any
) -> None:
    token = key_file.add("leaving", "watch")
    keys = service._app.state.service.keys
    keys.reload()

    async def run() -> list[str]:
        kinds: list[str] = []
        watching = {"Authorization": f"Bearer {token}"}
        async with (
            asyncio.timeout(PATIENCE),
            httpx2.AsyncClient(base_url=service.url) as http,
            opened(service, additional_headers=bearer("stream")) as socket,
        ):
            await started(socket)
            known = (await http.get("/sessions", headers=watching)).json()["sessions"]
            (session,) = (each["id"] for each in known if each["state"] == "running")
            events = f"/sessions/{session}/events"
            async with http.stream("GET", events, headers=watching) as answer:
                async for line in answer.aiter_lines():
                    if line.startswith("event: "):
                        kinds.append(line.removeprefix("event: "))
                    if line == "" and kinds[-1] == "history":
                        key_file.remove("leaving")
                        keys.reload()
                        for number in range(5):
                            await socket.send(json.dumps({"type": "ping", "id": number}))
            assert socket.close_code is None
        return kinds

    kinds = asyncio.run(run())
    assert kinds[:2] == ["ready", "history"]
    assert len(kinds) <= 3  # one message may have been on its way


def test_the_clients_send_their_key(service: RunningService, key_file: KeyFile) -> None:
    with LocalizationClient(service.url, key=key_file.tokens["localize"]) as recordings:
        assert recordings.arrays()
        with pytest.raises(ServiceProblem) as caught:
            recordings.sessions()
        assert (caught.value.code, caught.value.status) == ("role_missing", 403)
    with LocalizationClient(service.url) as nobody, pytest.raises(ServiceProblem) as caught:
        nobody.models()
    assert (caught.value.code, caught.value.status) == ("key_missing", 401)
    fields: dict[str, Any] = {key: START[key] for key in ("audio", "array", "method")}
    with StreamClient(service.url, key=key_file.tokens["stream"], **fields) as stream:
        stream.send(PIECE)
        assert stream.stop().audio_s == pytest.approx(0.1)
    with pytest.raises(StreamRefused) as refused, StreamClient(service.url, **fields):
        pass
    assert (refused.value.code, refused.value.retryable) == ("key_missing", False)


def test_a_client_whose_key_is_taken_away_does_not_come_back(
    service: RunningService, key_file: KeyFile
) -> None:
    token = key_file.add("leaving", "stream")
    state = service._app.state.service
    state.keys.reload()
    fields: dict[str, Any] = {key: START[key] for key in ("audio", "array", "method")}
    with StreamClient(service.url, key=token, **fields) as stream:
        key_file.remove("leaving")
        state.keys.reload()
        with pytest.raises(StreamClosed) as closed:
            for _ in stream:
                pass
    assert (closed.value.code, closed.value.close_code) == ("key_unknown", 4401)
    assert not closed.value.retryable
