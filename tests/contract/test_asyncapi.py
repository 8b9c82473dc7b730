"""``asyncapi.json`` and ``docs/protocol.md`` are the message models', and the server keeps them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import pytest
from fastapi.testclient import TestClient
from jsonschema import Draft202012Validator
from shown_answers import shown_objects

from neuralmusic.protocol.client_messages import CLIENT_MESSAGES
from neuralmusic.protocol.message import message_type
from neuralmusic.protocol.server_messages import SERVER_MESSAGES, WarningCode
from service.api.contract.asyncapi import document_json, renewed
from service.app import create_app
from service.doa.diagnostics.finding import FindingCode
from service.inference.registry import BundleRegistry
from service.settings import Settings

ROOT = Path(__file__).parents[2]
ASYNCAPI = ROOT / "asyncapi.json"


@pytest.fixture(scope="module")
def document() -> Any:
    return json.loads(ASYNCAPI.read_text())


def validator(document: Any, message: str) -> Draft202012Validator:
    payload = document["components"]["messages"][message]["payload"]
    return Draft202012Validator({**payload, "components": document["components"]})


def test_the_checked_in_document_is_the_models() -> None:
    assert ASYNCAPI.read_text() == document_json(), (
        "run: python -m service.api.contract.asyncapi > asyncapi.json"
    )


def test_the_tables_of_the_protocol_are_the_models() -> None:
    text = (ROOT / "docs" / "protocol.md").read_text()
    assert text == renewed(text), "run: python -m service.api.contract.asyncapi docs/protocol.md"


def test_every_message_is_in_the_channel_and_in_one_operation(document: Any) -> None:
    every = {message_type(each) for each in (*CLIENT_MESSAGES, *SERVER_MESSAGES)} | {"audio"}
    assert set(document["channels"]["stream"]["messages"]) == every
    named = [
        message["$ref"].rpartition("/")[2]
        for operation in document["operations"].values()
        for message in operation["messages"]
    ]
    assert sorted(named) == sorted(every)


def test_every_reference_leads_somewhere(document: Any) -> None:
    def references(part: Any) -> Any:
        if isinstance(part, dict):
            yield from ([part["$ref"]] if "$ref" in part else [])
            for value in part.values():
                yield from references(value)
        elif isinstance(part, list):
            for value in part:
                yield from references(value)

    for reference in references(document):
        place = document
        for step in reference.removeprefix("#/").split("/"):
            place = place[step]


@pytest.mark.parametrize(
    ("message", "accepted"),
    [
        ({"type": "stop"}, True),
        ({"type": "calibrate", "kind": "noise", "seconds": 5}, True),
        ({"type": "calibrate", "kind": "music"}, False),
        ({"type": "update", "output": {"interval_ms": 5}}, False),
        ({"type": "ping", "id": 1, "more": 2}, False),
    ],
)
def test_the_schemas_say_what_is_accepted(document: Any, message: Any, accepted: bool) -> None:
    assert validator(document, message["type"]).is_valid(message) is accepted


def test_the_protocol_document_shows_messages_that_are_valid(document: Any) -> None:
    shown = shown_objects((ROOT / "docs" / "protocol.md").read_text())
    messages = [each for each in shown if each["type"] in document["components"]["messages"]]
    assert {"start", "update", "flush", "ping", "calibrate", "stop"} < {
        message["type"] for message in messages
    }
    for message in messages:
        if "…" not in json.dumps(message, ensure_ascii=False):
            validator(document, message["type"]).validate(message)


def test_the_service_serves_the_document() -> None:
    with TestClient(create_app(Settings(), BundleRegistry(()))) as client:
        assert client.get("/asyncapi.json").text == document_json()


def test_every_finding_of_the_diagnostics_can_be_a_warning() -> None:
    assert set(get_args(FindingCode)) <= set(get_args(WarningCode))
