"""A service with keys: one for every role, and some with limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient
from key_file import KeyFile
from running_service import RunningService

from service.access.key_file import ROLES
from service.app import create_app
from service.settings import Settings


@pytest.fixture(scope="module")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> KeyFile:
    file = KeyFile(tmp_path_factory.mktemp("keys") / "keys.jsonl")
    for role in ROLES:
        file.add(role)
    file.add("one-stream", "stream", max_sessions=1)
    file.add("no-upload", "localize", max_uploads=0)
    file.add("two-seconds", "localize", "stream", audio_seconds_per_hour=2)
    file.add("parallel", "localize", audio_seconds_per_hour=2)
    file.add("unlucky", "localize", audio_seconds_per_hour=2)
    file.add("dashboard", "watch", "stream", origins=["https://dash.example"])
    file.add("old", "admin", expires="2020-01-01T00:00:00Z")
    return file


@pytest.fixture(scope="module")
def service(key_file: KeyFile) -> Iterator[RunningService]:
    running = RunningService(settings=Settings(workers=1, keys=key_file.path))
    yield running
    running.stop()


@pytest.fixture(scope="module")
def client(key_file: KeyFile) -> Iterator[TestClient]:
    app = create_app(Settings(workers=1, keys=key_file.path))
    with TestClient(app, raise_server_exceptions=False) as running:
        yield running


@pytest.fixture
def bearer(key_file: KeyFile) -> Any:
    return lambda name: {"Authorization": f"Bearer {key_file.tokens[name]}"}


# Who may do what
