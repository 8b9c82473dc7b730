"""A running service, as a log reader and a collector of traces see it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx2
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span
from running_service import RunningService
from watched_service import ARRAY, PATIENCE, SECONDS, localize, recording, scraped, stream

from neuralmusic.errors import ConfigError
from service.observability.traces import Traces
from service.settings import Settings

ROOT = Path(__file__).parents[2]
KEY = "nm_0123456789abcdefghijklmn"


def children(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def command_line(pid: str) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


class Process:
    """``neuralmusic serve`` as users start it; ``first`` is run before it."""

    def __init__(self, tmp_path: Path, *flags: str, first: str = "") -> None:
        self.log = tmp_path / "stderr.txt"
        program = f"{first}\nfrom neuralmusic.cli import main; raise SystemExit(main())"
        with self.log.open("w") as errors:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-c", program, "serve", "--port", "0"),
                    *("--workers", "1", "--stream-workers", "1", *flags),
                ],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}"},
            )
        self.pid = self._process.pid
        assert self._process.stdout is not None
        self.url = self._process.stdout.readline().split()[-1]
        self.socket = self.url.replace("http", "ws") + "/stream"

    def stop(self) -> tuple[int, list[str]]:
        """Stop as an orchestrator does; the exit status and the lines of the log."""
        self._process.send_signal(signal.SIGTERM)
        self._process.communicate(timeout=PATIENCE)
        return self._process.returncode, self.log.read_text().splitlines()


class Collector:
    """Takes traces by OTLP over HTTP, as Jaeger or an OpenTelemetry collector does."""

    def __init__(self) -> None:
        self.spans: list[Span] = []
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                assert self.path == "/v1/traces"
                request = ExportTraceServiceRequest.FromString(body)
                for resource in request.resource_spans:
                    for scope in resource.scope_spans:
                        collector.spans += scope.spans
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join(PATIENCE)
        self._server.server_close()


TRACE = "0af7651916cd43dd8448eb211c80319c"
BROKEN = "import service.api.page as page; page.page_files = None"
"""Program that turns the page's style sheet into an unexpected error"""


@dataclass(frozen=True)
class Watched:
    """A process after several requests: its answers, log and traces."""

    models: httpx2.Response
    style_sheet: httpx2.Response
    ready: httpx2.Response
    lost_worker: int
    status: int
    log: list[str]
    spans: list[Span]

    @property
    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.log]

    @property
    def servers(self) -> dict[str, Span]:
        """Spans of requests and streams by their names."""
        of_servers = [span for span in self.spans if span.kind == Span.SPAN_KIND_SERVER]
        spans = {f"{span.name} {attributes(span).get(STATUS, '')}": span for span in of_servers}
        assert len(spans) == len(of_servers)
        return spans


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Watched:
    """One life of one process; each of its parts has an id of its own in the log."""
    collector = Collector()
    flags = ("--log-format", "json", "--log-level", "debug", "--traces", collector.url)
    process = Process(tmp_path_factory.mktemp("watched"), *flags, first=BROKEN)
    authorization = {"Authorization": f"Bearer {KEY}"}
    options = {
        "subprotocols": ["doa.v1", f"bearer.{KEY}"],
        "additional_headers": {"X-Request-ID": "robot-7", **authorization},
    }
    asyncio.run(stream(f"{process.socket}?note={KEY}", start={"client": "seven"}, **options))
    models = httpx2.get(f"{process.url}/models?note={KEY}", headers=authorization)
    headers = {"X-Request-ID": "odd-1"}
    style_sheet = httpx2.get(f"{process.url}/static/style.css", headers=headers)
    headers = {"traceparent": f"00-{TRACE}-b7ad6b7169203331-01", "Content-Type": "audio/wav"}
    params = {"array": ARRAY, "secret": "hush"}
    httpx2.post(f"{process.url}/localize", content=b"x", params=params, headers=headers)
    assert localize(process.url, recording()).status_code == 200
    _, ready, _ = (httpx2.get(process.url + path) for path in ("/livez", "/readyz", "/metrics"))
    lost_worker = kill_stream_worker(process)
    status, log = process.stop()
    collector.close()
    return Watched(models, style_sheet, ready, lost_worker, status, log, collector.spans)


def kill_stream_worker(process: Process) -> int:
    """Wait until the service has noticed; the id of the process that was killed."""
    (worker,) = (
        int(pid) for pid in children(process.pid) if b"workers.stream" in command_line(pid)
    )
    os.kill(worker, signal.SIGKILL)
    name = 'neuralmusic_workers_lost_total{"kind": "stream"}'
    until = time.monotonic() + PATIENCE
    while scraped(process.url)[name] == 0:
        assert time.monotonic() < until
    return worker


def attributes(span: Span) -> dict[str, Any]:
    return {each.key: each.value.string_value or each.value.int_value for each in span.attributes}


STATUS = "http.response.status_code"


def test_the_log_is_json_line_by_line_with_the_ids_and_without_a_key(watched: Watched) -> None:
    lines = watched.lines
    assert not any(KEY in line for line in watched.log)
    assert all({"ts", "level", "logger", "message"} <= set(line) for line in lines)
    of_stream = [line for line in lines if line.get("request_id") == "robot-7"]
    began, ended = of_stream
    assert began["session_id"] == ended["session_id"]
    assert (began["message"], ended["message"]) == ("stream began", "stream ended: done")
    assert (began["client_name"], began["array"], began["model"]) == ("seven", ARRAY, "any-array")
    assert (ended["reason"], ended["audio_s"], ended["dropped_s"]) == ("done", SECONDS, 0)
    assert 0 < ended["lag_p50_ms"] <= ended["lag_max_ms"] + 1
    (asked,) = (line for line in lines if line.get("path") == "/models")
    assert asked["request_id"] == watched.models.headers["x-request-id"]


def test_a_defect_is_one_line_with_its_traceback_and_the_id_of_the_request(
    watched: Watched,
) -> None:
    answer = watched.style_sheet
    assert (answer.status_code, answer.headers["x-request-id"]) == (500, "odd-1")
    asked, failed = (line for line in watched.lines if line.get("request_id") == "odd-1")
    assert (asked["status"], asked["code"], asked["level"]) == (500, "internal", "error")
    assert failed["level"] == "error"
    assert "TypeError" in failed["exception"]


def test_a_lost_worker_is_counted_and_named_in_the_log(watched: Watched) -> None:
    errors = [line["message"] for line in watched.lines if line["level"] == "error"]
    assert any(str(watched.lost_worker) in message for message in errors)


def test_a_request_and_a_stream_have_a_span_each_and_probes_have_none(watched: Watched) -> None:
    servers = watched.servers
    assert set(servers) == {
        "WS /stream ",
        "GET /models 200",
        "GET /static/{name} 500",
        "POST /localize 422",
        "POST /localize 200",
    }
    posted, streamed = servers["POST /localize 422"], servers["WS /stream "]
    assert posted.trace_id.hex() == TRACE
    assert "hush" not in str(posted)
    ended = next(line for line in watched.lines if line["message"] == "stream ended: done")
    assert ended["trace_id"] == streamed.trace_id.hex()
    assert ended["span_id"] == streamed.span_id.hex()
    assert streamed.end_time_unix_nano > streamed.start_time_unix_nano
    assert not any(span.parent_span_id == streamed.span_id for span in watched.spans)


def test_the_span_of_a_recording_tells_the_work_from_the_upload(watched: Watched) -> None:
    posted = watched.servers["POST /localize 200"]
    (work,) = (span for span in watched.spans if span.parent_span_id == posted.span_id)
    assert work.name == "localize"
    assert posted.start_time_unix_nano <= work.start_time_unix_nano
    assert work.end_time_unix_nano <= posted.end_time_unix_nano


def test_a_process_that_was_asked_to_end_ends_well(watched: Watched) -> None:
    assert watched.ready.status_code == 200
    assert watched.status == 0
    assert any("Application shutdown complete" in line["message"] for line in watched.lines)


def test_a_collector_that_is_gone_holds_up_no_end() -> None:
    collector = Collector()
    service = RunningService(settings=Settings(workers=1, traces=collector.url))
    assert httpx2.get(f"{service.url}/models").status_code == 200
    collector.close()
    service.stop()


@pytest.mark.parametrize("missing", ["opentelemetry.sdk.trace", "fastapi.telemetry"])
def test_traces_without_the_extra_say_what_to_install(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ConfigError, match=r"pip install \./client '\.\[otel\]'"):
        Traces("http://localhost:4318")
