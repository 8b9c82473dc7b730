"""What documents and contracts show as answers is what the service answers about the sample."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
import yaml
from running_service import RunningService
from shown_answers import differences, shown_objects
from websocket_stream import opened, refusal

from service.recordings.options import OPTIONS

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "examples" / "two-talkers.flac"
PAGES = [*ROOT.glob("*.md"), *sorted((ROOT / "docs").rglob("*.md"))]
OPENAPI = yaml.safe_load((ROOT / "openapi.yaml").read_text())
MESSAGE_BYTES = 6400
PROBLEM_MEDIA_TYPE = "application/problem+json"


def conversation(service: RunningService, start: Any) -> list[Any]:
    """Everything that the service says about the sample."""
    samples, _ = soundfile.read(SAMPLE, dtype="int16")
    audio = samples.tobytes()

    async def converse() -> list[Any]:
        heard = []
        async with opened(service) as socket:
            await socket.send(json.dumps(start))
            heard.append(json.loads(await socket.recv()))
            if heard[0]["type"] != "ready":
                return heard
            reading = asyncio.create_task(_read(socket))
            for first in range(0, len(audio), MESSAGE_BYTES):
                await socket.send(audio[first : first + MESSAGE_BYTES])
            await socket.send('{"type":"stop"}')
            return heard + await reading

    async def _read(socket: Any) -> list[Any]:
        return [json.loads(text) async for text in socket]

    return asyncio.run(converse())


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    running = RunningService()
    yield running
    running.stop()


@pytest.fixture(scope="module")
def localized(service: RunningService) -> Any:
    files, data = {"audio": SAMPLE.read_bytes()}, {"array": "respeaker-usb-4mic-v2"}
    return httpx2.post(f"{service.url}/localize", files=files, data=data, timeout=60).json()


@pytest.fixture(scope="module")
def problem(service: RunningService) -> Any:
    """The answer to a recording of more channels than the array has microphones."""
    file = io.BytesIO()
    soundfile.write(file, np.zeros((1600, 8), np.int16), 16_000, format="WAV")
    files, data = {"audio": file.getvalue()}, {"array": "respeaker-usb-4mic-v2"}
    return httpx2.post(f"{service.url}/localize", files=files, data=data, timeout=60).json()


def test_the_answer_of_the_contract_is_the_service_s(localized: Any) -> None:
    responses = OPENAPI["paths"]["/localize"]["post"]["responses"]
    shown = responses["200"]["content"]["application/json"]["example"]
    assert len(shown["windows"]) == 1
    assert differences(shown, localized) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_answers_about_recordings_are_the_service_s(page: Path, request: Any) -> None:
    shown = [each for each in shown_objects(page.read_text()) if "windows" in each]
    for answer in shown:
        assert differences(answer, request.getfixturevalue("localized")) == []


def test_the_readme_shows_an_answer() -> None:
    assert any("windows" in each for each in shown_objects((ROOT / "README.md").read_text()))


def test_the_conversation_of_the_protocol_is_the_service_s(service: RunningService) -> None:
    shown = shown_objects((ROOT / "docs" / "protocol.md").read_text())
    start = next(each for each in shown if each.get("type") == "start")
    said = [
        *conversation(service, {**start, "overflow": "block"}),
        *conversation(service, start),  # in a burst
        *conversation(service, {**start, "array": {"name": "unknown"}}),
    ]
    answers = [each for each in shown if "seq" in each]
    assert {each["type"] for each in answers} == {
        *("ready", "result", "stats", "warning", "summary", "closing", "error"),
    }
    for answer in answers:
        alike = [
            each
            for each in said
            if (each["type"], each.get("t_end")) == (answer["type"], answer.get("t_end"))
        ]
        found = [differences(answer, each) for each in alike]
        assert [] in found, found


def test_the_refusal_of_the_protocol_is_the_service_s(service: RunningService) -> None:
    shown = shown_objects((ROOT / "docs" / "protocol.md").read_text())
    (refused,) = [each for each in shown if "status" in each]
    assert refusal(service, subprotocols=None)[:2] == (refused["status"], refused)


def test_the_problem_of_the_contract_is_the_service_s(problem: Any) -> None:
    fields = OPENAPI["components"]["schemas"]["Problem"]["properties"]
    assert {name: field["examples"][0] for name, field in fields.items()} == problem


def test_every_problem_has_the_fields_of_a_real_one(problem: Any) -> None:
    shown = [
        example["value"]
        for path in OPENAPI["paths"].values()
        for operation in path.values()
        for response in operation["responses"].values()
        for example in response.get("content", {})
        .get(PROBLEM_MEDIA_TYPE, {})
        .get("examples", {})
        .values()
    ]
    assert len(shown) > len(OPTIONS)
    for each in shown:
        assert each.keys() == problem.keys()
        assert each["type"].removesuffix(each["code"]) == problem["type"].removesuffix(
            problem["code"]
        )


def test_examples_of_options_can_be_read() -> None:
    given = {name: option for name, option in OPTIONS.items() if option.example is not None}
    assert given
    for option in given.values():
        assert option.example is not None
        option.read(option.example)
