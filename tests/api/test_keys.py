"""A service with keys, over HTTP and over a real socket: who gets in, and what a refusal says."""

from __future__ import annotations

import asyncio
import base64
import io
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
import websockets
from fastapi.testclient import TestClient
from running_service import RunningService
from starlette.routing import Mount, Route
from websockets.asyncio.client import ClientConnection, connect

from service.api.guard import NEEDED, needed_roles
from service.app import create_app
from service.client import LocalizationClient, ServiceProblem, StreamClient
from service.client.errors import StreamClosed, StreamRefused
from service.errors import ConfigError
from service.inference.registry import BundleRegistry
from service.key_file import ROLES, Key, new_token, token_sha256
from service.server import warn_if_open
from service.settings import Settings

PATIENCE = 30
START = {
    "type": "start",
    "audio": {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
    "array": {"name": "respeaker-usb-4mic-v2"},
    "method": "norm_music",
}
PIECE = np.random.default_rng(0).integers(-300, 300, (1600, 4)).astype("<i2").tobytes()
"""A tenth of a second"""
ARRAY = "respeaker-usb-4mic-v2"


@dataclass
class KeyFile:
    """A keys file and the tokens that belong to it."""

    path: Path
    tokens: dict[str, str] = field(default_factory=dict)
    lines: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, *roles: str, **limits: Any) -> str:
        token = self.tokens[name] = new_token()
        fields = {"name": name, "sha256": token_sha256(token), "roles": roles or [name], **limits}
        self.lines[name] = Key.model_validate(fields).line
        return self.write(token)

    def remove(self, name: str) -> None:
        del self.lines[name]
        self.write()

    def write(self, token: str = "") -> str:
        self.path.write_text("\n".join(self.lines.values()))
        self.path.chmod(0o600)
        return token


@pytest.fixture(scope="module")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> KeyFile:
    file = KeyFile(tmp_path_factory.mktemp("keys") / "keys.jsonl")
    for role in ROLES:
        file.add(role)
    file.add("one-stream", "stream", max_sessions=1)
    file.add("no-upload", "localize", max_uploads=0)
    file.add("two-seconds", "localize", "stream", audio_seconds_per_hour=2)
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


def test_every_path_of_the_application_was_decided_on(client: TestClient) -> None:
    """A path that nobody entered in the table is for administrators alone: enter it."""
    for route in client.app.routes:  # type: ignore[attr-defined]
        path = getattr(route, "path", None)
        if path is None:
            continue
        assert isinstance(route, Route | Mount) or path
        assert path == "/" or path.split("/")[1] in NEEDED, path


def test_a_path_that_nobody_decided_on_is_for_administrators(
    key_file: KeyFile, bearer: Any
) -> None:
    app = create_app(Settings(keys=key_file.path), BundleRegistry(()))
    app.add_api_route("/new", lambda: "secret")
    client = TestClient(app)
    assert client.get("/new").status_code == 401
    assert client.get("/new", headers=bearer("localize")).status_code == 403
    assert client.get("/new", headers=bearer("admin")).status_code == 200


@pytest.mark.parametrize("path", ["//localize", "/localize/x", "localize", "/LOCALIZE", "/admin/x"])
def test_other_spellings_of_a_path_need_no_less(path: str) -> None:
    assert needed_roles(path)


PUBLIC = ["/", "/livez", "/readyz", "/openapi.json", "/asyncapi.json", "/docs", "/static/main.js"]


@pytest.mark.parametrize("path", PUBLIC)
def test_probes_contracts_and_the_page_need_no_key(path: str, client: TestClient) -> None:
    assert client.get(path).status_code == 200
    wrong = {"Authorization": f"Bearer {new_token()}"}
    assert client.get(path, headers=wrong).status_code == 200


NEED = [
    ("GET", "/models", {"localize", "stream", "watch", "admin"}),
    ("GET", "/models/none", {"localize", "stream", "watch", "admin"}),
    ("GET", "/arrays", {"localize", "stream", "watch", "admin"}),
    ("POST", "/localize", {"localize", "admin"}),
    ("GET", "/noise", {"localize", "admin"}),
    ("GET", "/noise/none", {"localize", "admin"}),
    ("PUT", "/noise/none", {"localize", "admin"}),
    ("DELETE", "/noise/none", {"localize", "admin"}),
    ("GET", "/sessions", {"watch", "admin"}),
    ("GET", "/sessions/none/events", {"watch", "admin"}),
    ("GET", "/sessions/none/export", {"watch", "admin"}),
]


@pytest.mark.parametrize(("method", "path", "allowed"), NEED)
def test_every_path_asks_for_its_role(
    method: str, path: str, allowed: set[str], client: TestClient, bearer: Any
) -> None:
    missing = client.request(method, path)
    assert (missing.status_code, missing.json()["code"]) == (401, "key_missing")
    assert missing.headers["www-authenticate"] == 'Bearer realm="neuralmusic"'
    for role in ROLES:
        answer = client.request(method, path, headers=bearer(role))
        refused = answer.status_code == 403
        assert refused == (role not in allowed)
        if refused:
            assert answer.json()["code"] == "role_missing"
            assert 'error="insufficient_scope"' in answer.headers["www-authenticate"]


@pytest.mark.parametrize(
    "header",
    ["Bearer ", "Bearer wrong", "Basic bm1rXzEyMw==", "Bearer é".encode("latin-1"), "Bearer a b"],
)
def test_a_wrong_key_is_no_key(header: str | bytes, client: TestClient) -> None:
    answer = client.get("/models", headers={"Authorization": header})  # type: ignore[dict-item]
    assert answer.status_code == 401
    assert answer.json()["code"] in ("key_missing", "key_unknown")
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_scheme_may_be_spelt_as_one_likes(client: TestClient, key_file: KeyFile) -> None:
    headers = {"Authorization": f"bearer {key_file.tokens['watch']}"}
    assert client.get("/sessions", headers=headers).status_code == 200


def test_an_expired_key_says_so(client: TestClient, bearer: Any) -> None:
    answer = client.get("/models", headers=bearer("old"))
    assert (answer.status_code, answer.json()["code"]) == (401, "key_expired")
    assert 'error="invalid_token"' in answer.headers["www-authenticate"]


def test_what_does_not_exist_needs_no_key(client: TestClient) -> None:
    assert client.get("/nothing").status_code == 404


def test_a_body_is_not_read_for_nobody(service: RunningService) -> None:
    """The refusal comes although the body never does."""
    request = "POST /localize HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n"

    async def ask() -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", service.port)
        async with asyncio.timeout(PATIENCE):
            writer.write(request.encode())
            line = await reader.readline()
        writer.close()
        return line

    assert asyncio.run(ask()).startswith(b"HTTP/1.1 401")


@pytest.mark.parametrize("name", ["key", "token", "Access_Token", "api_key"])
def test_a_key_in_the_address_is_refused_and_not_logged(
    name: str, service: RunningService, key_file: KeyFile, written_log: io.StringIO
) -> None:
    secret = key_file.tokens["watch"]
    with httpx2.Client(base_url=service.url) as http:
        answer = http.get(f"/sessions?{name}={secret}")
        http.get("/livez")  # a line is written before the next request of its connection is read
    assert (answer.status_code, answer.json()["code"]) == (400, "key_in_address")
    assert "key_in_address" in written_log.getvalue()
    assert secret not in written_log.getvalue()
    assert secret not in answer.text


def test_answers_carry_the_headers_of_safety(client: TestClient) -> None:
    for path in ("/livez", "/models", "/nothing", "/"):
        headers = client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"


# Limits


def wav(seconds: float) -> bytes:
    samples = np.random.default_rng(0).normal(0, 0.1, (round(16_000 * seconds), 4))
    file = io.BytesIO()
    soundfile.write(file, samples, 16_000, format="WAV")
    return file.getvalue()


def post(client: TestClient, headers: dict[str, str], seconds: float = 1.5) -> httpx2.Response:
    headers = {**headers, "Content-Type": "audio/wav"}
    params = {"array": ARRAY, "method": "norm_music"}
    return client.post("/localize", content=wav(seconds), headers=headers, params=params)


def test_a_key_without_uploads_gets_429(client: TestClient, bearer: Any) -> None:
    answer = post(client, bearer("no-upload"))
    assert (answer.status_code, answer.json()["code"]) == (429, "too_many_uploads")
    assert int(answer.headers["retry-after"]) >= 1


def test_audio_is_charged_and_then_refused_until_it_has_drained(
    client: TestClient, bearer: Any
) -> None:
    assert post(client, bearer("two-seconds")).status_code == 200
    assert post(client, bearer("two-seconds")).status_code == 200  # 1.5 s of 2 are used before
    refused = post(client, bearer("two-seconds"))
    assert (refused.status_code, refused.json()["code"]) == (429, "audio_quota")
    # 3 s of 2 are used: one second drains in half an hour.
    assert int(refused.headers["retry-after"]) == pytest.approx(1800, abs=PATIENCE)
    assert post(client, bearer("localize")).status_code == 200
    stored = client.put("/noise/n", content=b"", headers=bearer("two-seconds"))
    assert stored.status_code == 429


# Streams


def handshake(service: RunningService, **options: Any) -> Any:
    arguments = {"subprotocols": ["doa.v1"], "compression": None, "close_timeout": 1, **options}
    return connect(service.url.replace("http", "ws") + "/stream", **arguments)


def refusal(service: RunningService, **options: Any) -> tuple[int, str, Any]:
    async def attempt() -> tuple[int, str, Any]:
        with pytest.raises(websockets.InvalidStatus) as caught:
            async with asyncio.timeout(PATIENCE), handshake(service, **options):
                pass
        response = caught.value.response
        return response.status_code, json.loads(response.body or b"{}")["code"], response.headers

    return asyncio.run(attempt())


async def started(socket: ClientConnection) -> None:
    await socket.send(json.dumps(START))
    while json.loads(await socket.recv())["type"] != "ready":
        pass


async def last_words(socket: ClientConnection) -> tuple[dict[str, Any], int | None]:
    last: dict[str, Any] = {}
    with suppress(websockets.ConnectionClosed):
        while True:
            last = json.loads(await socket.recv())
    return last, socket.close_code


def page_key(token: str) -> str:
    return "bearer." + base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")


def test_a_handshake_without_a_good_key_is_a_real_answer(
    service: RunningService, bearer: Any
) -> None:
    status, code, headers = refusal(service)
    assert (status, code) == (401, "key_missing")
    assert headers["www-authenticate"].startswith("Bearer")
    assert headers["content-type"] == "application/problem+json"
    wrong = {"Authorization": f"Bearer {new_token()}"}
    assert refusal(service, additional_headers=wrong)[:2] == (401, "key_unknown")
    assert refusal(service, additional_headers=bearer("localize"))[:2] == (403, "role_missing")
    offered = ["doa.v1", page_key(new_token())]
    assert refusal(service, subprotocols=offered)[:2] == (401, "key_unknown")
    for junk in ("bearer.", "bearer.!!!", "bearer.gICA"):
        assert refusal(service, subprotocols=["doa.v1", junk])[0] == 401


def test_a_key_as_header_or_subprotocol_opens_a_stream(
    service: RunningService, key_file: KeyFile, bearer: Any
) -> None:
    token = key_file.tokens["stream"]

    async def opened(**options: Any) -> str | None:
        async with asyncio.timeout(PATIENCE), handshake(service, **options) as socket:
            await started(socket)
            return socket.subprotocol  # type: ignore[no-any-return]

    assert asyncio.run(opened(additional_headers=bearer("stream"))) == "doa.v1"
    # Offered first, too: the answer must never repeat the key.
    assert asyncio.run(opened(subprotocols=[page_key(token), "doa.v1"])) == "doa.v1"


def test_a_keys_origins_are_for_that_key_alone(service: RunningService, bearer: Any) -> None:
    page = "https://dash.example"
    refused = refusal(service, origin=page, additional_headers=bearer("stream"))
    assert refused[:2] == (403, "origin_refused")

    async def opened() -> None:
        headers = bearer("dashboard")
        async with (
            asyncio.timeout(PATIENCE),
            handshake(service, origin=page, additional_headers=headers) as socket,
        ):
            await started(socket)

    asyncio.run(opened())


def test_a_key_has_its_number_of_streams_and_gets_the_place_back(
    service: RunningService, bearer: Any
) -> None:
    headers = bearer("one-stream")

    async def two() -> tuple[int, str, Any]:
        async with (
            asyncio.timeout(PATIENCE),
            handshake(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            found = await asyncio.to_thread(refusal, service, additional_headers=headers)
            await socket.send('{"type":"stop"}')
            await last_words(socket)
            return found

    for _ in range(2):
        status, code, answer = asyncio.run(two())
        assert (status, code) == (429, "too_many_sessions")
        assert int(answer["retry-after"]) >= 1


def test_a_stream_ends_when_its_keys_audio_is_used_up(
    service: RunningService, key_file: KeyFile, bearer: Any
) -> None:
    headers = bearer("two-seconds")

    async def run() -> tuple[dict[str, Any], int | None]:
        async with (
            asyncio.timeout(PATIENCE),
            handshake(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            with suppress(websockets.ConnectionClosed):
                for _ in range(30):
                    await socket.send(PIECE)
            return await last_words(socket)

    last, close_code = asyncio.run(run())
    assert (last["type"], last["code"], close_code) == ("error", "audio_quota", 4429)
    status, code, answer = refusal(service, additional_headers=headers)
    assert (status, code) == (429, "audio_quota")
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
            handshake(service, additional_headers=headers) as socket,
        ):
            await started(socket)
            key_file.remove("leaving")
            state.keys.reload()
            return await last_words(socket)

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
            handshake(service, additional_headers=bearer("stream")) as socket,
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


def test_a_prefix_of_a_proxy_changes_nothing(key_file: KeyFile, bearer: Any) -> None:
    app = create_app(Settings(keys=key_file.path), BundleRegistry(()))
    client = TestClient(app, root_path="/doa")
    assert client.get("/doa/livez").status_code == 200
    for path in ("/doa/sessions", "/sessions"):
        assert client.get(path).status_code == 401
        assert client.get(path, headers=bearer("watch")).status_code == 200


# Clients


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


# The start


def test_a_wrong_file_of_keys_keeps_the_service_from_starting(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        create_app(Settings(keys=tmp_path / "none"), BundleRegistry(()))


@pytest.mark.parametrize(
    ("host", "loud"),
    [
        ("0.0.0.0", True),
        ("::", True),
        ("192.168.1.5", True),
        ("", True),
        ("127.0.0.1", False),
        ("127.0.1.1", False),
        ("::1", False),
        ("localhost", False),
    ],
)
def test_an_open_service_is_loud_about_it(
    host: str, loud: bool, key_file: KeyFile, caplog: pytest.LogCaptureFixture
) -> None:
    warn_if_open(Settings(host=host, keys=key_file.path))
    assert not caplog.records
    warn_if_open(Settings(host=host))
    assert ("NO API KEYS" in caplog.text) == loud
    if loud:
        assert "neuralmusic key new" in caplog.text
