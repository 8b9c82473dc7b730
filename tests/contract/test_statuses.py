"""Every status that ``openapi.yaml`` documents is real: some request gets it, as documented.

Whoever documents another one adds the request to ``REQUESTS``.
"""

from __future__ import annotations

import io
import json
import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from errno import EACCES, ENOSPC
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx2
import numpy as np
import pytest
import soundfile
import yaml
from jsonschema import Draft202012Validator
from running_service import RunningService
from websockets.sync.client import connect

from neuralmusic.errors import BundleNotFound
from service.access.key_file import Key, new_token, token_sha256
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.whitening import NoiseCovariance
from service.inference.noise_profile import noise_bytes
from service.inference.noise_store import NoiseStore
from service.lifecycle import Lifecycle, Phase
from service.settings import Settings

DOCUMENT = yaml.safe_load((Path(__file__).parents[2] / "openapi.yaml").read_text())
ARRAY = "respeaker-usb-4mic-v2"
SECOND = np.random.default_rng(0).integers(-300, 300, (16_000, 4)).astype(np.int16)
LIMIT = 2**20
PATIENCE_S = 30.0
"""Seconds until a hanging test fails"""


TOKENS = {role: new_token() for role in ("localize", "stream", "watch", "admin")}
BODY_TIMEOUT_S = 0.2


@dataclass(frozen=True)
class Subject:
    """A running service, and the client that asks it."""

    service: RunningService
    client: httpx2.Client
    guarded: httpx2.Client
    """Client of another service, which has keys and waits for no body"""

    def localize(self, content: bytes, media_type: str = "audio/wav") -> httpx2.Response:
        parameters = {"array": ARRAY, "method": "music"}
        headers = {"Content-Type": media_type}
        return self.client.post("/localize", content=content, params=parameters, headers=headers)

    def stream(self) -> str:
        """The id of a stream that ended and had results."""
        audio = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4}
        start = {"type": "start", "audio": audio, "array": {"name": ARRAY}, "method": "music"}
        url = self.service.url.replace("http", "ws") + "/stream"
        with connect(url, subprotocols=["doa.v1"], compression=None) as socket:  # type: ignore[list-item]
            socket.send(json.dumps(start))
            socket.send(SECOND[:6400].tobytes())
            socket.send('{"type":"stop"}')
            messages = [json.loads(text) for text in socket]
        return str(messages[0]["session"])


def wav() -> bytes:
    file = io.BytesIO()
    soundfile.write(file, SECOND, 16_000, format="WAV")
    return file.getvalue()


def profile() -> bytes:
    """A noise profile, as small as it can be."""
    stft = Stft(16_000, 16, 8)
    covariance = np.tile(np.eye(4, dtype=np.complex64), (stft.num_bins, 1, 1))
    return noise_bytes(NoiseCovariance(covariance, preset(ARRAY), stft, 1.0))


State = Callable[[Subject], AbstractContextManager[None]]


@contextmanager
def draining(subject: Subject) -> Iterator[None]:
    lifecycle = Lifecycle()
    lifecycle.enter(Phase.DRAINING)
    with patch.object(subject.service.state, "lifecycle", lifecycle):
        yield


@contextmanager
def not_ready(subject: Subject) -> Iterator[None]:
    registry, subject.service.state.registry = subject.service.state.registry, None
    yield
    subject.service.state.registry = registry


def failing(place: str, error: Exception) -> State:
    """A defect, or a fault of the machine, which no honest request provokes."""

    @contextmanager
    def state(_: Subject) -> Iterator[None]:
        with patch(place, side_effect=error):
            yield

    return state


BROKEN = failing("service.api.localize.read_options", ZeroDivisionError())
DISK_FULL = failing(
    "service.inference.noise_store.NoiseStore.put", OSError(ENOSPC, "No space left on device")
)
UNDELETABLE = failing(
    "service.inference.noise_store.NoiseStore.delete", PermissionError(EACCES, "Permission denied")
)
NO_BUNDLE = failing("service.api.state.load_registry", BundleNotFound("no such folder"))

Ask = Callable[[Subject], httpx2.Response]


def ask(method: str, path: str, during: State | None = None, **request: Any) -> Ask:
    """A request, and the state of the service for it."""

    def send(subject: Subject) -> httpx2.Response:
        if during is None:
            return subject.client.request(method, path, **request)
        with during(subject):
            return subject.client.request(method, path, **request)

    return send


def named(method: str, **request: Any) -> Ask:
    """A request about a stored noise profile."""

    def send(subject: Subject) -> httpx2.Response:
        assert subject.client.put("/noise/one", content=profile()).status_code == 200
        return subject.client.request(method, "/noise/one", **request)

    return send


def of_a_stream(path: str, **request: Any) -> Ask:
    def send(subject: Subject) -> httpx2.Response:
        return subject.client.get(f"/sessions/{subject.stream()}/{path}", **request)

    return send


def too_many_watchers(limit: str) -> Ask:
    """A watcher where nobody may watch; ``limit`` holds the most."""

    def send(subject: Subject) -> httpx2.Response:
        with patch(limit, 0):
            return of_a_stream("events")(subject)

    return send


def one_too_many(subject: Subject) -> httpx2.Response:
    """One noise profile above the limit."""
    with patch.object(subject.service.state, "noise", NoiseStore(capacity=1)):
        assert subject.client.put("/noise/one", content=profile()).status_code == 200
        return subject.client.put("/noise/two", content=profile())


def while_busy(subject: Subject) -> httpx2.Response:
    """A recording while the limit of recordings is reached."""
    workers = subject.service.state.recording_workers
    assert subject.localize(wav()).status_code == 200  # the worker is up
    (pid,) = workers.pids
    os.kill(pid, signal.SIGSTOP)
    try:
        with ThreadPoolExecutor(1) as executor:
            first = executor.submit(subject.localize, wav())
            while not workers.admitted:
                assert subject.client.get("/livez").status_code == 200
            answer = subject.localize(wav())
            os.kill(pid, signal.SIGCONT)
            assert first.result(PATIENCE_S).status_code == 200
    finally:
        os.kill(pid, signal.SIGCONT)
    return answer


def guarded(method: str, path: str, role: str | None = None, **request: Any) -> Ask:
    """A request to the service with keys, with the key of a role."""
    headers = {"Authorization": f"Bearer {TOKENS[role]}"} if role else {}
    return lambda subject: subject.guarded.request(method, path, headers=headers, **request)


def too_slow(method: str, path: str) -> Ask:
    """A request whose body stops coming."""

    def send(subject: Subject) -> httpx2.Response:
        def body() -> Iterator[bytes]:
            yield b"RIFF"
            until = time.monotonic() + 2 * BODY_TIMEOUT_S
            while time.monotonic() < until:
                assert subject.client.get("/livez").status_code == 200

        headers = {"Authorization": f"Bearer {TOKENS['admin']}", "Content-Type": "audio/wav"}
        return subject.guarded.request(method, path, headers=headers, content=body())

    return send


FILLED = {"session_id": "none", "name": "none"}
ELSEWHERE = {"Host": "elsewhere.example"}
KEY_IN_ADDRESS = {"key": "x"}


def refusals() -> Iterator[tuple[tuple[str, str, int], Ask]]:
    """What the guard says to requests of every path."""
    for path, operations in DOCUMENT["paths"].items():
        filled = path.format(**FILLED)
        for method, operation in operations.items():
            verb, roles = method.upper(), operation.get("x-roles", [])
            yield (method, path, 400), ask(verb, filled, params=KEY_IN_ADDRESS)
            yield (method, path, 421), ask(verb, filled, headers=ELSEWHERE)
            if roles:
                yield (method, path, 401), guarded(verb, filled)
            if (wrong := sorted(TOKENS.keys() - set(roles))) and roles:
                yield (method, path, 403), guarded(verb, filled, wrong[0])
            if "429" in operation["responses"]:
                yield (method, path, 429), guarded(verb, filled, "localize", content=b"x")
            if "408" in operation["responses"]:
                yield (method, path, 408), too_slow(verb, filled)


REQUESTS: dict[tuple[str, str, int], Ask] = dict(refusals()) | {
    ("post", "/localize", 200): lambda s: s.localize(wav()),
    ("post", "/localize", 400): lambda s: s.localize(b"x", "multipart/form-data"),
    ("post", "/localize", 413): lambda s: s.localize(bytes(LIMIT + 1)),
    ("post", "/localize", 415): lambda s: s.localize(b"x", "text/plain"),
    ("post", "/localize", 422): lambda s: s.localize(b""),
    ("post", "/localize", 500): ask("POST", "/localize", BROKEN, content=b"x"),
    ("post", "/localize", 503): while_busy,
    ("get", "/sessions", 200): ask("GET", "/sessions"),
    ("get", "/sessions", 422): ask("GET", "/sessions", params={"replicas": "some"}),
    ("get", "/sessions/{session_id}/events", 200): of_a_stream("events"),
    ("get", "/sessions/{session_id}/events", 404): ask("GET", "/sessions/none/events"),
    ("get", "/sessions/{session_id}/events", 422): of_a_stream(
        "events", params={"replicas": "some"}
    ),
    ("get", "/sessions/{session_id}/events", 429): too_many_watchers(
        "service.access.keys.MAX_WATCHERS"
    ),
    ("get", "/sessions/{session_id}/events", 503): too_many_watchers(
        "service.streaming.registry.MAX_WATCHERS"
    ),
    ("get", "/sessions/{session_id}/export", 200): of_a_stream("export"),
    ("get", "/sessions/{session_id}/export", 404): ask("GET", "/sessions/none/export"),
    ("get", "/sessions/{session_id}/export", 422): of_a_stream("export", params={"format": "xml"}),
    ("get", "/noise", 200): ask("GET", "/noise"),
    ("get", "/noise/{name}", 200): named("GET"),
    ("get", "/noise/{name}", 404): ask("GET", "/noise/none"),
    ("put", "/noise/{name}", 200): named("PUT", content=profile()),
    ("put", "/noise/{name}", 409): one_too_many,
    ("put", "/noise/{name}", 413): ask("PUT", "/noise/one", content=bytes(LIMIT + 1)),
    ("put", "/noise/{name}", 422): ask("PUT", "/noise/one", content=b"x"),
    ("put", "/noise/{name}", 503): ask("PUT", "/noise/one", DISK_FULL, content=profile()),
    ("delete", "/noise/{name}", 204): named("DELETE"),
    ("delete", "/noise/{name}", 404): ask("DELETE", "/noise/none"),
    ("delete", "/noise/{name}", 503): ask("DELETE", "/noise/one", UNDELETABLE),
    ("get", "/models", 200): ask("GET", "/models"),
    ("get", "/models", 503): ask("GET", "/models", not_ready),
    ("get", "/models/{name}", 200): ask("GET", "/models/any-array"),
    ("get", "/models/{name}", 404): ask("GET", "/models/none"),
    ("get", "/models/{name}", 503): ask("GET", "/models/any-array", not_ready),
    ("get", "/arrays", 200): ask("GET", "/arrays"),
    ("post", "/admin/reload", 200): ask("POST", "/admin/reload"),
    ("post", "/admin/reload", 409): ask("POST", "/admin/reload", NO_BUNDLE),
    ("post", "/admin/reload", 503): ask("POST", "/admin/reload", draining),
    ("get", "/livez", 200): ask("GET", "/livez"),
    ("get", "/readyz", 200): ask("GET", "/readyz"),
    ("get", "/readyz", 503): ask("GET", "/readyz", draining),
    ("get", "/asyncapi.json", 200): ask("GET", "/asyncapi.json"),
    ("get", "/metrics", 200): ask("GET", "/metrics"),
    ("get", "/", 200): ask("GET", "/"),
}
"""Requests by the method, path and status that they get"""

DOCUMENTED = {
    (method, path, int(status)): response
    for path, operations in DOCUMENT["paths"].items()
    for method, operation in operations.items()
    for status, response in operation["responses"].items()
}


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Subject]:
    keys = tmp_path_factory.mktemp("keys") / "keys.jsonl"
    keys.write_text(
        "\n".join(
            Key(
                name=role,
                sha256=token_sha256(token),
                roles=(role,),
                max_uploads=0 if role == "localize" else None,
            ).line
            for role, token in TOKENS.items()
        )
    )
    keys.chmod(0o600)
    service = RunningService(settings=Settings(workers=1, queue=0, max_upload_bytes=LIMIT))
    other = RunningService(settings=Settings(workers=1, keys=keys, body_timeout_s=BODY_TIMEOUT_S))
    with (
        httpx2.Client(base_url=service.url, timeout=PATIENCE_S) as client,
        httpx2.Client(base_url=other.url, timeout=PATIENCE_S) as keyed,
    ):
        yield Subject(service, client, keyed)
    service.stop()
    other.stop()


def test_every_documented_status_has_its_request() -> None:
    assert set(REQUESTS) == set(DOCUMENTED)


@pytest.mark.parametrize("place", REQUESTS, ids=lambda place: " ".join(map(str, place)))
def test_a_documented_status_is_real(place: tuple[str, str, int], subject: Subject) -> None:
    method, path, status = place
    answer = REQUESTS[place](subject)
    assert answer.status_code == status, answer.text
    assert answer.request.method.lower() == method
    assert re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", path), answer.request.url.path)
    response = DOCUMENTED[place]
    assert {name.lower() for name in response.get("headers", {})} <= set(answer.headers)
    if "content" not in response:
        assert answer.content == b""
        return
    media_type = answer.headers["content-type"].partition(";")[0]
    schema = response["content"][media_type].get("schema", {})
    if media_type.endswith("json"):
        document = {**schema, "components": DOCUMENT["components"]}
        Draft202012Validator(document).validate(answer.json())
