"""Every request and stream has an id, a line and a count."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from neuralmusic.errors import BundleNotFound
from service.api.middleware.request_watch import SHOWN_PATH
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.lifecycle import Phase
from service.settings import Settings

LOGGER = "service.api.middleware.request_watch"


@pytest.fixture
def client() -> Iterator[TestClient]:
    app = create_app(Settings(workers=1), BundleRegistry(()))

    @app.get("/broken")
    async def broken() -> None:
        raise ZeroDivisionError("because")

    @app.get("/refusing")
    async def refusing() -> None:
        raise BundleNotFound("no such folder")

    with TestClient(app, raise_server_exceptions=False) as running:
        yield running


def lines(caplog: pytest.LogCaptureFixture) -> list[dict[str, Any]]:
    """Lines of requests, without what the test's own client logs."""
    return [vars(each) for each in caplog.records if each.name == LOGGER]


def counted(client: TestClient, name: str) -> dict[str, float]:
    """Counts above nought by their labels, as they are written."""
    found = {}
    for line in client.get("/metrics").text.splitlines():
        if line.startswith(f"neuralmusic_{name}{{"):
            labels, _, value = line.rpartition(" ")
            if float(value):
                found[labels.removeprefix(f"neuralmusic_{name}")] = float(value)
    return found


@pytest.mark.parametrize("ident", ["a", "4bf92f35-77b3.4da6:x/y=@+_", "x" * 128])
def test_a_sane_id_is_taken_over(client: TestClient, ident: str) -> None:
    assert client.get("/livez", headers={"X-Request-ID": ident}).headers["x-request-id"] == ident


@pytest.mark.parametrize("ident", ["", "x" * 129, "a b", "a\tb", 'a"b', "a;b", "ä".encode()])
def test_any_other_gets_one_of_ours(client: TestClient, ident: Any) -> None:
    answered = client.get("/livez", headers={"X-Request-ID": ident}).headers["x-request-id"]
    assert answered != ident
    assert len(answered) == 16
    assert int(answered, 16) >= 0


def test_every_answer_has_an_id_of_its_own(client: TestClient) -> None:
    paths = ("/livez", "/nothing", "/broken", "/models", "/static/style.css")
    answers = [client.get(path) for path in paths]
    assert len({answer.headers["x-request-id"] for answer in answers}) == len(paths)


def test_a_request_is_one_line_without_its_query(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service")
    answer = client.get("/models?name=secret", headers={"Authorization": "Bearer secret"})
    (line,) = lines(caplog)
    assert (line["method"], line["path"], line["status"]) == ("GET", "/models", 200)
    assert line["client"] == "testclient"
    assert line["duration_ms"] > 0
    assert answer.status_code == 200
    assert "secret" not in str(line)


def test_a_refusal_is_a_line_with_its_code_and_no_traceback(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service")
    client.post("/localize", content=b"", headers={"Content-Type": "text/plain"})
    client.get("/nothing/" + "x" * 999)
    refused, missing = lines(caplog)
    assert (refused["status"], refused["code"]) == (415, "media_type_unsupported")
    assert (missing["status"], missing["code"]) == (404, "not_found")
    assert len(missing["path"]) == SHOWN_PATH
    ours = [each for each in caplog.records if each.name.startswith("service")]
    assert not any(each.exc_info for each in ours)
    assert {each.levelname for each in ours} == {"INFO"}


def test_a_defect_is_an_error_with_the_id_that_the_client_sees(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service")
    answer = client.get("/broken")
    assert answer.json()["code"] == "internal"
    assert len(answer.headers["x-request-id"]) == 16
    (line,) = lines(caplog)
    assert (line["levelname"], line["status"], line["code"]) == ("ERROR", 500, "internal")


def test_a_failure_that_has_a_code_shows_its_traceback(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    client.get("/refusing")
    (told,) = (each for each in caplog.records if each.name == "service.api.problems")
    assert told.levelname == "ERROR"
    assert told.exc_info is not None
    assert isinstance(told.exc_info[1], BundleNotFound)


def test_probes_are_quiet_while_all_is_well(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service")
    for path in ("/livez", "/readyz", "/metrics"):
        client.get(path)
    assert not lines(caplog)
    client.app.state.service.lifecycle.enter(Phase.DRAINING)  # type: ignore[attr-defined]
    client.get("/readyz")
    (line,) = lines(caplog)
    assert (line["levelname"], line["code"]) == ("WARNING", "draining")


def test_requests_are_counted_by_the_template_of_their_route(client: TestClient) -> None:
    client.get("/models/one")
    client.get("/models/two")
    client.get("/openapi.json")
    for index in range(5):
        client.get(f"/made/up/{index}")
    client.delete("/models")
    assert counted(client, "requests_total") == {
        '{method="GET",path="/models/{name}",status="404"}': 2,
        '{method="GET",path="/openapi.json",status="200"}': 1,
        '{method="GET",path="other",status="404"}': 5,
        '{method="DELETE",path="/models",status="405"}': 1,
    }
    assert counted(client, "errors_total") == {
        '{code="not_found"}': 7,
        '{code="method_not_allowed"}': 1,
    }


def test_what_was_refused_before_its_route_is_counted_there(client: TestClient) -> None:
    assert client.get("/models/one?key=secret").json()["code"] == "key_in_address"
    assert counted(client, "requests_total") == {
        '{method="GET",path="/models/{name}",status="400"}': 1
    }


def test_a_refused_handshake_is_counted_and_logged(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service")
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/stream?robot=secret"):
        pass
    (line,) = lines(caplog)
    assert (line["method"], line["path"], line["status"]) == ("WEBSOCKET", "/stream", 400)
    assert line["code"] == "subprotocol_missing"
    label = '{method="WEBSOCKET",path="/stream",status="400"}'
    assert counted(client, "requests_total")[label] == 1
    assert counted(client, "errors_total") == {'{code="subprotocol_missing"}': 1}
    assert counted(client, "sessions_ended_total") == {}


def test_a_body_over_the_limit_is_counted(client: TestClient) -> None:
    headers = {"Content-Length": str(2**40), "Content-Type": "audio/wav"}
    assert client.post("/localize", content=b"x", headers=headers).status_code == 413
    assert counted(client, "errors_total") == {'{code="upload_too_large"}': 1}


def test_metrics_come_in_the_format_that_is_asked_for(client: TestClient) -> None:
    text = client.get("/metrics")
    assert text.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    accept = "application/openmetrics-text;version=1.0.0;q=0.9,text/plain;version=0.0.4;q=0.3"
    openmetrics = client.get("/metrics", headers={"Accept": accept})
    assert openmetrics.headers["content-type"].startswith("application/openmetrics-text")
    assert openmetrics.text.endswith("# EOF\n")


def test_lines_can_be_written_as_json(client: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    from service.observability.logs import JsonFormatter

    caplog.set_level(logging.INFO, "service")
    client.get("/models/%0aforged")
    (record,) = (each for each in caplog.records if each.name == LOGGER)
    written = JsonFormatter().format(record)
    assert "\n" not in written
    assert json.loads(written)["path"] == "/models/\nforged"
