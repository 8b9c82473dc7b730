"""The service around localization: probes, catalog, capacity, clients that hang up."""

from __future__ import annotations

import errno
from tempfile import SpooledTemporaryFile
from typing import Any

import anyio
import pytest
from fastapi.testclient import TestClient

from neuralmusic import __version__
from neuralmusic.errors import ConfigError
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.settings import Settings

ARRAY = "respeaker-usb-4mic-v2"
PATIENCE = 20  # seconds until a hanging test fails
HEADERS = {"Content-Type": "audio/wav"}


def small_app(**settings: Any) -> Any:
    return create_app(Settings(**settings), BundleRegistry(()))


def test_the_service_is_alive_but_not_ready_before_its_models_are_loaded() -> None:
    client = TestClient(create_app(Settings()))  # without its lifespan
    assert client.get("/livez").status_code == 200
    for response in (
        client.get("/readyz"),
        client.get("/models"),
        client.post("/localize", content=b"", headers=HEADERS),
    ):
        assert response.status_code == 503
        assert response.json()["code"] == "not_ready"
        assert "retry-after" in response.headers


@pytest.mark.parametrize("probe", ["/livez", "/readyz"])
def test_probes_answer_to_head(probe: str) -> None:
    with TestClient(small_app()) as client:
        answer = client.head(probe)
    assert (answer.status_code, answer.content) == (200, b"")


def test_a_default_model_that_is_not_loaded_stops_the_start() -> None:
    app = create_app(Settings(default_model="nobody"))
    says = "default_model: no model is named 'nobody'"
    with pytest.raises(ConfigError, match=says), TestClient(app):
        pass


def test_a_full_disk_is_no_server_error(monkeypatch: pytest.MonkeyPatch) -> None:
    async def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("starlette.datastructures.UploadFile.write", full)
    with TestClient(small_app()) as client:
        for response in (
            client.post("/localize", content=b"RIFF", headers=HEADERS),
            client.post("/localize", files={"audio": b"RIFF"}),
            client.put("/noise/fan", content=b"PK"),
        ):
            assert response.status_code == 503
            assert response.json()["code"] == "disk_full"
            assert "no room" in response.json()["detail"]


def test_an_unexpected_error_is_a_problem_that_gives_nothing_away(
    sounds: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr("service.api.localize.read_options", broken)
    with TestClient(small_app(), raise_server_exceptions=False) as client:
        response = client.post(
            "/localize", params={"array": ARRAY}, content=sounds.wav(), headers=HEADERS
        )
    assert response.status_code == 500
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["code"] == "internal"
    assert "secret" not in response.text
    assert "Zero" not in response.text


def test_the_arrays_are_those_that_requests_may_name(client: TestClient) -> None:
    arrays = {array["name"]: array for array in client.get("/arrays").json()["arrays"]}
    square = arrays[ARRAY]
    assert square["num_microphones"] == 4
    assert square["aperture_m"] == pytest.approx(0.0646, abs=1e-4)
    assert square["positions_m"][1] == [-0.02285, 0.02285, 0.0]
    assert square["raw_channels"] == {"6": [1, 2, 3, 4]}
    assert square["source"]


def test_the_models_tell_what_they_are(client: TestClient) -> None:
    models = client.get("/models").json()["models"]
    for model in models:
        assert len(model["sha256"]) == 64
        assert model["variant"] in ("weights", "regression")
        assert model["sample_rate"] == 16_000
        assert model["scores"]
    assert [model["default"] for model in models] == [n == 0 for n in range(len(models))]


def test_a_model_shows_its_card(client: TestClient) -> None:
    listed = client.get("/models").json()["models"][0]
    shown = client.get(listed["details"]).json()
    assert shown.pop("card").startswith("# Model card: `any-array`")
    assert shown == listed
    missing = client.get("/models/nobody")
    assert (missing.status_code, missing.json()["code"]) == (404, "not_found")


def test_the_root_says_where_to_go(client: TestClient) -> None:
    root = client.get("/").json()
    assert root["version"] == __version__
    for name in ("models", "arrays", "documentation", "openapi"):
        assert client.get(root["links"][name]).status_code == 200


async def drive(app: Any, content_type: str, messages: list[dict[str, Any]]) -> list[Any]:
    """Run one request by hand, with exactly these messages from the client."""
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "POST",
        "path": "/localize",
        "raw_path": b"/localize",
        "query_string": f"array={ARRAY}".encode(),
        "headers": [(b"content-type", content_type.encode())],
    }
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        return messages.pop(0) if len(messages) > 1 else messages[0]

    async def send(message: Any) -> None:
        sent.append(message)

    with anyio.fail_after(PATIENCE):
        await app(scope, receive, send)
        await app.state.service.stop()
    return sent


@pytest.fixture
def spooled(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every temporary file that uploads make."""
    files: list[Any] = []

    def spool(*args: Any, **kwargs: Any) -> Any:
        files.append(SpooledTemporaryFile(*args, **kwargs))  # noqa: SIM115 - closing is tested
        return files[-1]

    monkeypatch.setattr("service.api.upload.TemporaryFile", spool)
    monkeypatch.setattr("starlette.formparsers.SpooledTemporaryFile", spool)
    return files


FORM_START = b'--y\r\nContent-Disposition: form-data; name="audio"; filename="a"\r\n\r\nRIFF'


@pytest.mark.parametrize(
    ("content_type", "start"),
    [("audio/wav", b"RIFF"), ("multipart/form-data; boundary=y", FORM_START)],
)
def test_a_client_that_hangs_up_during_the_upload_leaves_no_file_behind(
    spooled: list[Any], content_type: str, start: bytes
) -> None:
    messages: list[dict[str, Any]] = [
        {"type": "http.request", "body": start + bytes(2**21), "more_body": True},
        {"type": "http.disconnect"},
    ]
    app = small_app()
    anyio.run(drive, app, content_type, messages)
    assert [file.closed for file in spooled] == [True]


def test_an_upload_over_the_limit_leaves_no_file_behind(spooled: list[Any]) -> None:
    more = {"type": "http.request", "body": bytes(2**20), "more_body": True}
    sent = anyio.run(drive, small_app(max_upload_bytes=2**21), "audio/wav", [more])
    assert sent[0]["status"] == 413
    assert [file.closed for file in spooled] == [True]


def test_a_client_that_hangs_up_gets_no_work_done(sounds: Any, spooled: list[Any]) -> None:
    messages: list[dict[str, Any]] = [
        {"type": "http.request", "body": sounds.wav(), "more_body": False},
        {"type": "http.disconnect"},
    ]
    app = small_app()
    sent = anyio.run(drive, app, "audio/wav", messages)
    assert [message.get("body") for message in sent] == [None, b""]
    assert app.state.service.recording_workers.admitted == 0
    assert [file.closed for file in spooled] == [True]
