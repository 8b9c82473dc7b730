"""A service that really runs, as Prometheus, a log reader and a collector of traces see it."""

from __future__ import annotations

import asyncio
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span
from prometheus_client.parser import text_string_to_metric_families
from running_service import RunningService
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosedError

from service.errors import ConfigError
from service.observability.traces import Traces
from service.settings import Settings

ROOT = Path(__file__).parents[2]
ARRAY = "respeaker-usb-4mic-v2"
SECONDS = 2.0
PATIENCE = 30
"""Seconds until a hanging test fails"""
KEY = "nm_0123456789abcdefghijklmn"


async def stream(
    url: str, *, start: dict[str, Any] | None = None, seconds: float = SECONDS, **options: Any
) -> list[str]:
    """Stream noise in pieces of 100 ms and stop; the types of what was answered."""
    audio = {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4}
    basis = {"type": "start", "audio": audio, "array": {"name": ARRAY}, "overflow": "block"}
    noise = np.random.default_rng(0).integers(-300, 300, (round(16000 * seconds), 4))
    arguments: dict[str, Any] = {"subprotocols": ["doa.v1"], "compression": None, **options}
    answered: list[str] = []
    async with asyncio.timeout(PATIENCE), connect(url, **arguments) as socket:
        await socket.send(json.dumps({**basis, **(start or {})}))
        for begin in range(0, len(noise), 1600):
            await socket.send(noise[begin : begin + 1600].astype("<i2").tobytes())
        await socket.send('{"type":"stop"}')
        async for text in socket:
            answered.append(json.loads(text)["type"])
    return answered


def localize(url: str, wav: bytes) -> httpx2.Response:
    headers = {"Content-Type": "audio/wav"}
    params = {"array": ARRAY}
    return httpx2.post(f"{url}/localize", params=params, content=wav, headers=headers, timeout=30)


def recording() -> bytes:
    """1.5 s of noise as a WAV file."""
    noise = np.random.default_rng(0).integers(-300, 300, (24_000, 4)).astype("<i2")
    file = io.BytesIO()
    soundfile.write(file, noise, 16_000, format="WAV")
    return file.getvalue()


def scraped(url: str) -> dict[str, float]:
    """Values by the names as they are written, labels included."""
    text = httpx2.get(f"{url}/metrics").text
    return {
        sample.name + (json.dumps(sample.labels) if sample.labels else ""): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def names(values: dict[str, float]) -> set[str]:
    """Metrics of our own, whatever their parts are called."""
    written = {name.partition("{")[0] for name in values if name.startswith("neuralmusic_")}
    return {re.sub(r"_(bucket|sum|count)$", "", name) for name in written}


@pytest.fixture(scope="module")
def used() -> Iterator[tuple[dict[str, float], dict[str, float], list[str]]]:
    """Scrapes before and after a stream, a file and three errors; what the stream was answered."""
    service = RunningService(settings=Settings(workers=1, stream_workers=1))
    url, socket = service.url, service.url.replace("http", "ws") + "/stream"
    before = scraped(url)
    with pytest.raises(ConnectionClosedError, match="4400"):
        asyncio.run(stream(socket, start={"array": {"name": "nobody's"}}, seconds=0))
    answered = asyncio.run(stream(socket))
    assert localize(url, recording()).status_code == 200
    for body in (b"no audio", b""):
        localize(url, body)
    yield before, scraped(url), answered
    service.stop()


def test_every_metric_of_the_document_is_there_from_the_start_and_no_other(used: Any) -> None:
    table = (ROOT / "docs" / "monitoring.md").read_text()
    documented = set(re.findall(r"^\| `(neuralmusic_\w+)` ", table, re.MULTILINE))
    before, after, _ = used
    unasked = {"neuralmusic_requests_total", "neuralmusic_request_seconds"}
    assert names(before) == documented - unasked
    assert names(after) == documented
    assert "process_cpu_seconds_total" in after


def test_seconds_of_audio_are_those_that_were_sent(used: Any) -> None:
    after = used[1]
    assert after['neuralmusic_audio_seconds_total{"kind": "stream"}'] == pytest.approx(SECONDS)
    assert after['neuralmusic_audio_seconds_total{"kind": "recording"}'] == pytest.approx(1.5)
    assert after["neuralmusic_audio_dropped_seconds_total"] == 0


def test_every_result_of_the_stream_has_a_lag_and_a_latency(used: Any) -> None:
    _, after, answered = used
    results = answered.count("result")
    assert results >= 10 * SECONDS - 1
    assert after["neuralmusic_lag_seconds_count"] == results
    assert after["neuralmusic_result_latency_seconds_count"] == results
    lag, latency = (after[f"neuralmusic_{name}_seconds_sum"] for name in ("lag", "result_latency"))
    # The latency goes on where the lag ends; a lag is rounded to a tenth of a millisecond.
    assert 0 < lag <= latency + results * 5e-5


def test_work_is_timed_by_its_kind(used: Any) -> None:
    _, after, answered = used
    for name in ("queue", "inference"):
        steps = after[f'neuralmusic_{name}_seconds_count{{"kind": "stream"}}']
        assert steps >= answered.count("result")
        assert after[f'neuralmusic_{name}_seconds_count{{"kind": "recording"}}'] >= 1
    assert after['neuralmusic_inference_seconds_sum{"kind": "recording"}'] > 0
    # 1.5 s in hops of half the window, in batches
    assert after["neuralmusic_batch_windows_sum"] >= 2


def test_errors_are_counted_by_their_code(used: Any) -> None:
    after = used[1]
    errors = {name: value for name, value in after.items() if "errors_total" in name and value}
    assert errors == {
        'neuralmusic_errors_total{"code": "not_audio"}': 1,
        'neuralmusic_errors_total{"code": "audio_missing"}': 1,
        'neuralmusic_errors_total{"code": "array_unknown"}': 1,
    }


def test_streams_are_counted_when_they_end_and_the_gauges_go_back(used: Any) -> None:
    after = used[1]
    ended = {name: value for name, value in after.items() if "sessions_ended" in name and value}
    assert ended == {
        'neuralmusic_sessions_ended_total{"reason": "done"}': 1,
        'neuralmusic_sessions_ended_total{"reason": "array_unknown"}': 1,
    }
    assert after["neuralmusic_sessions"] == 0
    assert after["neuralmusic_uploads"] == 0
    assert after["neuralmusic_ready"] == 1
    assert after['neuralmusic_workers{"kind": "stream"}'] == 1


def children(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def command_line(pid: str) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


class Process:
    """``neuralmusic serve`` as users start it; ``first`` is run before it."""

    def __init__(self, tmp_path: Path, *flags: str, first: str = "") -> None:
        self.log = tmp_path / "stderr.txt"
        program = f"{first}\nfrom service.cli import main; raise SystemExit(main())"
        with self.log.open("w") as errors:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-c", program, "serve", "--port", "0"),
                    *("--workers", "1", "--stream-workers", "1", *flags),
                ],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
        self.pid = self._process.pid
        assert self._process.stdout is not None
        self.url = self._process.stdout.readline().split()[-1]
        self.socket = self.url.replace("http", "ws") + "/stream"

    def stop(self) -> list[str]:
        """Stop as an orchestrator does; the lines of the log."""
        self._process.send_signal(signal.SIGTERM)
        self._process.communicate(timeout=PATIENCE)
        return self.log.read_text().splitlines()


def test_the_log_is_json_line_by_line_with_the_ids_and_without_a_key(tmp_path: Path) -> None:
    process = Process(tmp_path, "--log-format", "json", "--log-level", "debug")
    options = {
        "subprotocols": ["doa.v1", f"bearer.{KEY}"],
        "additional_headers": {"X-Request-ID": "robot-7", "Authorization": f"Bearer {KEY}"},
    }
    asyncio.run(stream(f"{process.socket}?note={KEY}", start={"client": "seven"}, **options))
    answer = httpx2.get(
        f"{process.url}/models?note={KEY}", headers={"Authorization": f"Bearer {KEY}"}
    )
    written = process.stop()
    lines = [json.loads(line) for line in written]
    assert not any(KEY in line for line in written)
    assert all({"ts", "level", "logger", "message"} <= set(line) for line in lines)
    of_stream = [line for line in lines if line.get("request_id") == "robot-7"]
    began, ended = of_stream
    assert began["session_id"] == ended["session_id"]
    assert (began["message"], ended["message"]) == ("stream began", "stream ended: done")
    assert (began["client_name"], began["array"], began["model"]) == ("seven", ARRAY, "any-array")
    assert (ended["reason"], ended["audio_s"], ended["dropped_s"]) == ("done", SECONDS, 0)
    assert 0 < ended["lag_p50_ms"] <= ended["lag_max_ms"] + 1
    (asked,) = (line for line in lines if line.get("path") == "/models")
    assert asked["request_id"] == answer.headers["x-request-id"]


def test_a_defect_is_one_line_with_its_traceback_and_the_id_of_the_request(tmp_path: Path) -> None:
    broken = "import service.api.page as page; page.page_files = None"
    process = Process(tmp_path, "--log-format", "json", first=broken)
    answer = httpx2.get(f"{process.url}/static/style.css", headers={"X-Request-ID": "odd-1"})
    assert (answer.status_code, answer.headers["x-request-id"]) == (500, "odd-1")
    lines = [json.loads(line) for line in process.stop()]
    asked, failed = (line for line in lines if line.get("request_id") == "odd-1")
    assert (asked["status"], asked["code"], asked["level"]) == (500, "internal", "error")
    assert failed["level"] == "error"
    assert "TypeError" in failed["exception"]


def test_a_lost_worker_is_counted_and_named_in_the_log(tmp_path: Path) -> None:
    process = Process(tmp_path, "--log-format", "json")

    (worker,) = (
        int(pid) for pid in children(process.pid) if b"workers.stream" in command_line(pid)
    )
    os.kill(worker, signal.SIGKILL)
    name = 'neuralmusic_workers_lost_total{"kind": "stream"}'
    until = time.monotonic() + PATIENCE
    while scraped(process.url)[name] == 0:
        assert time.monotonic() < until
    lines = [json.loads(line) for line in process.stop()]
    assert any(str(worker) in line["message"] for line in lines if line["level"] == "error")


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


@pytest.fixture
def collector() -> Iterator[Collector]:
    running = Collector()
    yield running
    running.close()


def attributes(span: Span) -> dict[str, Any]:
    return {each.key: each.value.string_value or each.value.int_value for each in span.attributes}


def test_a_request_and_a_stream_have_a_span_each_and_probes_have_none(
    tmp_path: Path, collector: Collector
) -> None:
    process = Process(tmp_path, "--traces", collector.url, "--log-format", "json")
    trace = "0af7651916cd43dd8448eb211c80319c"
    headers = {"traceparent": f"00-{trace}-b7ad6b7169203331-01", "Content-Type": "audio/wav"}
    params = {"array": ARRAY, "secret": "hush"}
    httpx2.post(f"{process.url}/localize", content=b"x", params=params, headers=headers)
    asyncio.run(stream(process.socket))
    for path in ("/livez", "/readyz", "/metrics"):
        httpx2.get(process.url + path)
    lines = [json.loads(line) for line in process.stop()]
    servers = [span for span in collector.spans if span.kind == Span.SPAN_KIND_SERVER]
    assert sorted(span.name for span in servers) == ["POST /localize", "WS /stream"]
    posted, streamed = sorted(servers, key=lambda span: span.name)
    assert posted.trace_id.hex() == trace
    assert attributes(posted)["http.response.status_code"] == 422
    assert "hush" not in str(posted)
    ended = next(line for line in lines if line["message"] == "stream ended: done")
    assert ended["trace_id"] == streamed.trace_id.hex()
    assert ended["span_id"] == streamed.span_id.hex()
    assert streamed.end_time_unix_nano > streamed.start_time_unix_nano
    inside = {span.name for span in collector.spans if span.parent_span_id == streamed.span_id}
    assert not inside


def test_the_span_of_a_recording_tells_the_work_from_the_upload(
    tmp_path: Path, collector: Collector
) -> None:
    process = Process(tmp_path, "--traces", collector.url)
    assert localize(process.url, recording()).status_code == 200
    process.stop()
    posted = next(span for span in collector.spans if span.kind == Span.SPAN_KIND_SERVER)
    (work,) = (span for span in collector.spans if span.parent_span_id == posted.span_id)
    assert work.name == "localize"
    assert posted.start_time_unix_nano <= work.start_time_unix_nano
    assert work.end_time_unix_nano <= posted.end_time_unix_nano


def test_a_collector_that_is_gone_holds_up_no_end(tmp_path: Path, collector: Collector) -> None:
    process = Process(tmp_path, "--traces", collector.url, "--log-format", "json")
    httpx2.get(f"{process.url}/models")
    collector.close()
    lines = [json.loads(line) for line in process.stop()]
    assert any("Application shutdown complete" in line["message"] for line in lines)


def test_without_traces_nothing_of_the_sdk_is_imported() -> None:
    code = (
        "import sys; from service.app import create_app; create_app(); "
        "print([name for name in sys.modules if name.startswith('opentelemetry.sdk')"
        " or name.startswith('opentelemetry.exporter')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("missing", ["opentelemetry.sdk.trace", "fastapi.telemetry"])
def test_traces_without_the_extra_say_what_to_install(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ConfigError, match=r"pip install 'neuralmusic\[otel\]'"):
        Traces("http://localhost:4318")
