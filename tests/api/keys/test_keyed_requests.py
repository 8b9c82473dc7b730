"""A service with keys over HTTP: who gets in, and what a refusal says."""

from __future__ import annotations

import asyncio
import io
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
from fastapi.testclient import TestClient
from key_file import KeyFile
from running_service import RunningService
from starlette.routing import Mount, Route

from neuralmusic.errors import ConfigError
from service.access.key_file import ROLES, new_token
from service.api.middleware.guard import NEEDED, needed_roles
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.server import warn_if_open
from service.settings import Settings

PATIENCE = 30
ARRAY = "respeaker-usb-4mic-v2"


def test_every_path_of_the_application_was_decided_on(client: TestClient) -> None:
    """A path without a rule is for administrators alone: add a rule for it."""
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


def wav(seconds: float, damaged: bool) -> bytes:
    samples = np.random.default_rng(0).normal(0, 0.1, (round(16_000 * seconds), 4))
    if damaged:
        samples[0] = np.nan
    file = io.BytesIO()
    soundfile.write(file, samples, 16_000, format="WAV", subtype="FLOAT")
    return file.getvalue()


def post(
    client: TestClient, headers: dict[str, str], seconds: float = 1.5, *, damaged: bool = False
) -> httpx2.Response:
    headers = {**headers, "Content-Type": "audio/wav"}
    params = {"array": ARRAY, "method": "norm_music"}
    return client.post("/localize", content=wav(seconds, damaged), headers=headers, params=params)


def test_a_key_without_uploads_gets_429(client: TestClient, bearer: Any) -> None:
    answer = post(client, bearer("no-upload"))
    assert (answer.status_code, answer.json()["code"]) == (429, "too_many_uploads")
    assert int(answer.headers["retry-after"]) >= 1


def test_audio_that_exceeds_the_limit_is_refused_until_enough_has_drained(
    client: TestClient, bearer: Any
) -> None:
    key = bearer("two-seconds")
    assert post(client, key).status_code == 200
    refused = post(client, key)
    assert (refused.status_code, refused.json()["code"]) == (429, "audio_quota")
    # 3 s of 2 would be used: one second drains in half an hour.
    assert int(refused.headers["retry-after"]) == pytest.approx(1800, abs=PATIENCE)
    assert post(client, bearer("localize")).status_code == 200


def test_a_recording_longer_than_the_limit_is_refused_with_the_remedy(
    client: TestClient, bearer: Any
) -> None:
    refused = post(client, bearer("unlucky"), 3.0)
    assert (refused.status_code, refused.json()["code"]) == (413, "audio_too_long")
    assert "split it" in refused.json()["detail"]
    assert "retry-after" not in refused.headers


def test_recordings_in_parallel_get_no_more_than_one_after_the_other(
    client: TestClient, bearer: Any
) -> None:
    """Each reserves its audio before any of it is localized."""
    with ThreadPoolExecutor(8) as executor:
        answers = list(executor.map(lambda _: post(client, bearer("parallel")), range(8)))
    codes = [answer.status_code for answer in answers]
    assert (codes.count(200), codes.count(429)) == (1, 7)


def test_what_was_reserved_and_not_localized_is_given_back(client: TestClient, bearer: Any) -> None:
    for _ in range(2):
        damaged = post(client, bearer("unlucky"), damaged=True)
        assert damaged.json()["code"] == "audio_non_finite"
    assert post(client, bearer("unlucky")).status_code == 200


def test_a_prefix_of_a_proxy_changes_nothing(key_file: KeyFile, bearer: Any) -> None:
    app = create_app(Settings(keys=key_file.path), BundleRegistry(()))
    client = TestClient(app, root_path="/doa")
    assert client.get("/doa/livez").status_code == 200
    for path in ("/doa/sessions", "/sessions"):
        assert client.get(path).status_code == 401
        assert client.get(path, headers=bearer("watch")).status_code == 200


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
