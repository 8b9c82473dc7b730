"""Recordings over HTTP: the real application answers, and everything that can go wrong speaks."""

from __future__ import annotations

import asyncio
import io
import json
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import soundfile

from neuralmusic import (
    AsyncLocalizationClient,
    InvalidAnswer,
    LocalizationClient,
    ServiceProblem,
    ServiceUnreachable,
)
from neuralmusic.errors import InvalidOption
from service.doa.array import MicrophoneArray
from service.doa.presets import PRESETS


@pytest.fixture
def url(real_service: str) -> str:
    return real_service


@pytest.fixture
def wav(square: MicrophoneArray, plane_waves: Any) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, plane_waves(square, [60]).T, 16_000, format="WAV")
    return file.getvalue()


def direction(answer: dict[str, Any]) -> float:
    return float(answer["summary"]["sources"][0]["azimuth_deg"])


def test_a_path_a_file_and_bytes_give_the_same_answer(
    url: str, wav: bytes, square: MicrophoneArray, tmp_path: Path
) -> None:
    path = tmp_path / "talk.wav"
    path.write_bytes(wav)
    asked = {"array": square.name, "method": "norm_music"}
    with LocalizationClient(url) as client, path.open("rb") as file:
        answers = [client.localize(given, **asked) for given in (path, str(path), file, wav)]
    assert all(answer == answers[0] for answer in answers)
    assert direction(answers[0]) == pytest.approx(60, abs=3)


def test_geometry_and_options_are_sent_as_they_are_written(
    url: str, wav: bytes, square: MicrophoneArray
) -> None:
    turned = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the array's own x is the robot's y
    options = {"channel_map": (0, 1, 2, 3), "max_sources": 1, "spectrum": True, "model": None}
    with LocalizationClient(url) as client:
        for array in (square.positions, {"name": "own", "positions_m": square.positions}):
            answer = client.localize(wav, array=array, method="music", **options)
            assert direction(answer) == pytest.approx(60, abs=3)
            assert len(answer["windows"][0]["spectrum"]) == 360
        answer = client.localize(wav, array=(square.positions @ turned).tolist(), method="music")
    assert direction(answer) == pytest.approx(330, abs=3)


@pytest.mark.parametrize("sectors", [[(50, 70)], [(300.5, 20), (50, 70)], "50:70"])
def test_sectors_are_pairs_of_degrees(
    url: str, wav: bytes, square: MicrophoneArray, sectors: Any
) -> None:
    with LocalizationClient(url) as client:
        heard = client.localize(wav, array=square.name, yaw_deg=90, exclude_deg=sectors)
        assert direction(heard) == pytest.approx(150, abs=3)
        answer = client.localize(wav, array=square.name, exclude_deg=sectors)
    assert answer["summary"]["sources"] == []


def test_what_the_service_offers(url: str) -> None:
    with LocalizationClient(url) as client:
        assert [array["name"] for array in client.arrays()] == list(PRESETS)
        assert client.models()[0]["default"]


def test_a_refusal_is_the_service_s_problem(url: str, wav: bytes) -> None:
    with LocalizationClient(url) as client, pytest.raises(ServiceProblem) as caught:
        client.localize(wav, array="respeaker")
    problem = caught.value
    assert (problem.code, problem.status, problem.retryable) == ("array_unknown", 422, False)
    assert problem.title == "Unknown array"
    assert "no array preset is called 'respeaker'" in problem.detail
    assert str(problem) == problem.detail


def test_the_same_with_asyncio(url: str, wav: bytes, square: MicrophoneArray) -> None:
    async def ask() -> tuple[dict[str, Any], int]:
        async with AsyncLocalizationClient(url) as client:
            answer = await client.localize(wav, array=square.name, method="norm_music")
            await client.models()
            with pytest.raises(ServiceProblem, match="no array preset"):
                await client.localize(io.BytesIO(wav), array="respeaker")
            return answer, len(await client.arrays())

    answer, arrays = asyncio.run(ask())
    assert direction(answer) == pytest.approx(60, abs=3)
    assert arrays == len(PRESETS)


def answering(status: int, content: bytes, **headers: str) -> LocalizationClient:
    def answer(request: httpx.Request) -> httpx.Response:
        return httpx.Response(status, headers=headers, content=content)

    return LocalizationClient("http://robot", transport=httpx.MockTransport(answer))


def test_a_full_service_says_when_to_come_back() -> None:
    body = json.dumps({"code": "overloaded", "title": "Overloaded", "detail": "full"}).encode()
    with (
        answering(503, body, **{"Retry-After": "2"}) as client,
        pytest.raises(ServiceProblem, match="full") as caught,
    ):
        client.localize(b"RIFF", array="square")
    assert caught.value.retryable
    assert caught.value.retry_after_s == 2


@pytest.mark.parametrize("body", [b"<html>hello</html>", b"[]", b'{"other": 1}', b""])
def test_another_server_is_noticed(body: bytes) -> None:
    with answering(200, body) as client, pytest.raises(InvalidAnswer, match="check the address"):
        client.models()
    with answering(500, body) as client, pytest.raises(ServiceProblem, match="HTTP status 500"):
        client.arrays()


def test_the_key_is_sent_as_a_header() -> None:
    seen: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers["Authorization"])
        return httpx.Response(200, json={"sessions": []})

    transport = httpx.MockTransport(answer)
    for key in ("secret", "secret\n"):  # as a file holds it
        with LocalizationClient("http://robot", key=key, transport=transport) as client:
            assert client.sessions() == []
    assert seen == ["Bearer secret"] * 2


@pytest.mark.parametrize("key", ["schlüssel", "two\nlines"])
def test_what_can_be_no_key_is_a_sentence(key: str) -> None:
    with pytest.raises(InvalidOption, match="no key has"):
        LocalizationClient("http://robot", key=key)


def test_nobody_there_is_a_sentence(unused_tcp_port: int) -> None:
    url = f"http://127.0.0.1:{unused_tcp_port}"
    with (
        LocalizationClient(url) as client,
        pytest.raises(ServiceUnreachable, match="nothing answers"),
    ):
        client.models()


def test_a_missing_file_is_the_system_s_error(tmp_path: Path) -> None:
    with LocalizationClient("http://robot") as client, pytest.raises(FileNotFoundError):
        client.localize(tmp_path / "none.wav", array="square")
