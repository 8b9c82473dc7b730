"""The checked-in ``openapi.yaml`` is the contract: the application and the errors keep it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from neuralmusic.client_errors import ClientError
from neuralmusic.errors import (
    BundleError,
    ConfigError,
    DoaError,
    NoiseCalibrationFailed,
    NoiseProfileInvalid,
    NoiseStoreFull,
    RecordingUnreadable,
    StreamProtocolError,
    TooManyWatchers,
)
from service.openapi import document_yaml

CHECKED_IN = Path(__file__).parents[2] / "openapi.yaml"


@pytest.fixture(scope="module")
def document() -> Any:
    return yaml.safe_load(CHECKED_IN.read_text())


def leaves(error: type[DoaError] = DoaError) -> Iterator[type[DoaError]]:
    """Errors that are raised, rather than only caught."""
    for child in error.__subclasses__():
        yield from leaves(child)
    if not error.__subclasses__():
        yield error


def test_the_document_is_the_applications() -> None:
    regenerate = "run: python -m service.openapi > openapi.yaml"
    assert document_yaml() == CHECKED_IN.read_text(), regenerate


def test_every_path_of_the_protocol_is_there(document: Any) -> None:
    assert set(document["paths"]) >= {
        "/localize",
        "/models",
        "/arrays",
        "/noise",
        "/noise/{name}",
        "/livez",
        "/readyz",
        "/sessions",
        "/sessions/{session_id}/events",
        "/sessions/{session_id}/export",
        "/admin/reload",
        "/",
    }


def test_every_error_of_a_request_is_documented_with_its_status(document: Any) -> None:
    documented = problems(document["paths"]["/localize"]["post"])
    elsewhere = (
        BundleError,
        ClientError,
        ConfigError,
        NoiseCalibrationFailed,
        NoiseProfileInvalid,
        RecordingUnreadable,
        StreamProtocolError,
        TooManyWatchers,
    )
    expected = {
        (e.status, e.code) for e in leaves() if not issubclass(e, (*elsewhere, NoiseStoreFull))
    }
    assert documented == expected | {(400, "upload_invalid"), (500, "internal")}


def test_every_error_of_storing_noise_is_documented_with_its_status(document: Any) -> None:
    assert problems(document["paths"]["/noise/{name}"]["put"]) == {
        (400, "key_in_address"),
        (401, "key_missing"),
        (401, "key_unknown"),
        (401, "key_expired"),
        (403, "role_missing"),
        (403, "origin_refused"),
        (408, "request_timeout"),
        (409, "noise_full"),
        (421, "host_refused"),
        (429, "too_many_uploads"),
        (429, "audio_quota"),
        (413, "upload_too_large"),
        (422, "noise_invalid"),
        (422, "option_invalid"),
        (503, "too_many_connections"),
        (503, "disk_full"),
    }


def problems(operation: Any) -> set[tuple[int, str]]:
    """Statuses and codes that an operation documents."""
    return {
        (int(status), code)
        for status, response in operation["responses"].items()
        for code in response.get("content", {})
        .get("application/problem+json", {})
        .get("examples", {})
    }


def test_codes_are_unique() -> None:
    codes = [error.code for error in leaves()]
    assert len(set(codes)) == len(codes)


def test_both_bodies_and_every_option_are_documented(document: Any) -> None:
    operation = document["paths"]["/localize"]["post"]
    content = operation["requestBody"]["content"]
    assert set(content) == {"multipart/form-data", "audio/*", "application/octet-stream"}
    options = {
        "array",
        "channel_map",
        "model",
        "method",
        "num_sources",
        "max_sources",
        "window_s",
        "hop_s",
        "yaw_deg",
        "exclude_deg",
        "hemisphere",
        "noise",
        "spectrum",
    }
    assert {parameter["name"] for parameter in operation["parameters"]} == options
    assert set(content["multipart/form-data"]["schema"]["properties"]) == options | {"audio"}


def test_every_reference_leads_somewhere(document: Any) -> None:
    def references(node: Any) -> Iterator[str]:
        if isinstance(node, dict):
            yield from (value for key, value in node.items() if key == "$ref")
            for value in node.values():
                yield from references(value)
        elif isinstance(node, list):
            for value in node:
                yield from references(value)

    known = {f"#/components/schemas/{name}" for name in document["components"]["schemas"]}
    found = set(references(document))
    assert found <= known
    assert "#/components/schemas/Problem" in found


def test_operation_ids_are_names_that_generators_like(document: Any) -> None:
    ids = [
        operation["operationId"]
        for path in document["paths"].values()
        for operation in path.values()
    ]
    assert len(set(ids)) == len(ids)
    assert all(name.isidentifier() for name in ids)
