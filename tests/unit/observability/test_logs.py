"""Lines of the log: one each, with what was known, without what is secret."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from opentelemetry.sdk.trace import TracerProvider

from service.observability.logs import (
    JsonFormatter,
    TextFormatter,
    request_id,
    server_log_level,
    session_id,
)
from service.settings import Settings

ROOT = Path(__file__).parents[2]
FORMATTERS = (JsonFormatter(), TextFormatter())


def record(message: str, *arguments: Any, **fields: Any) -> logging.LogRecord:
    made = logging.LogRecord("service.test", logging.INFO, __file__, 1, message, arguments, None)
    made.__dict__.update(fields)
    return made


@contextmanager
def bound(variable: ContextVar[str | None], value: str) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def json_line(made: logging.LogRecord, worker: str | None = None) -> dict[str, Any]:
    line: dict[str, Any] = json.loads(JsonFormatter(worker).format(made))
    return line


def test_a_json_line_has_the_fields_of_the_document() -> None:
    made = record("%s %d", "GET /x", 200, method="GET", status=200, duration_ms=1.5)
    line = json_line(made)
    assert line == {
        "ts": line["ts"],
        "level": "info",
        "logger": "service.test",
        "message": "GET /x 200",
        "method": "GET",
        "status": 200,
        "duration_ms": 1.5,
    }
    assert line["ts"].endswith("Z")
    moment = datetime.fromisoformat(line["ts"])
    assert moment.tzinfo == UTC
    assert abs(moment.timestamp() - made.created) <= 0.001


def test_ids_are_in_every_line_of_their_context_and_in_no_other() -> None:
    with bound(request_id, "r-1"), bound(session_id, "s-1"):
        line = json_line(record("in it"), worker="stream-7")
        text = TextFormatter("stream-7").format(record("in it"))
    assert (line["request_id"], line["session_id"], line["worker"]) == ("r-1", "s-1", "stream-7")
    assert "request_id=r-1 session_id=s-1 worker=stream-7" in text
    assert not {"request_id", "session_id", "worker"} & set(json_line(record("outside")))


def test_a_line_carries_the_ids_of_its_span() -> None:
    with TracerProvider().get_tracer("test").start_as_current_span("work") as span:
        line = json_line(record("traced"))
    context = span.get_span_context()
    assert int(line["trace_id"], 16) == context.trace_id
    assert int(line["span_id"], 16) == context.span_id
    assert len(line["trace_id"]) == 32
    assert "trace_id" not in json_line(record("not traced"))


@given(st.text(), st.text())
def test_nothing_that_came_over_the_wire_begins_a_line(message: str, path: str) -> None:
    for formatter in FORMATTERS:
        written = formatter.format(record("%s", message, path=path, client_name=path))
        assert len(written.splitlines()) == 1


@given(st.text())
def test_json_lines_give_back_what_was_logged(path: str) -> None:
    if "bearer" not in path.lower():
        assert json_line(record("asked", path=path))["path"] == path


@pytest.mark.parametrize(
    "message",
    [
        "Authorization: Bearer nm_0123456789abcdef",
        "authorization: bearer nm_0123456789abcdef",
        "Sec-WebSocket-Protocol: doa.v1, bearer.nm_0123456789abcdef",
    ],
)
def test_keys_are_never_written(message: str) -> None:
    for formatter in FORMATTERS:
        for written in (
            formatter.format(record(message)),
            formatter.format(record("x", d=message)),
        ):
            assert "nm_0123456789abcdef" not in written
            assert "[hidden]" in written


def test_a_traceback_stays_in_the_line_of_its_error() -> None:
    try:
        raise ZeroDivisionError("because")
    except ZeroDivisionError:
        made = record("failed")
        made.exc_info = sys.exc_info()
    written = JsonFormatter().format(made)
    assert "\n" not in written
    exception = json.loads(written)["exception"]
    assert exception.startswith("Traceback")
    assert exception.endswith("ZeroDivisionError: because")


def test_a_process_logs_all_that_it_has_to_say_as_json() -> None:
    program = """
import logging, threading, warnings
import anyio, anyio.to_thread
from service.observability.logs import configure_logging, request_id
from service.settings import Settings
configure_logging(Settings(log_format="json"), "stream_worker-7")
async def main():
    request_id.set("r-1")
    await anyio.to_thread.run_sync(logging.getLogger("service.work").info, "in a thread")
anyio.run(main)
logging.getLogger("another.library").warning("two\\nlines")
logging.getLogger("another.library").info("of no interest")
warnings.warn("careful")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert all(line["worker"] == "stream_worker-7" for line in lines)
    threaded, foreign, warned = lines
    assert (threaded["message"], threaded["request_id"]) == ("in a thread", "r-1")
    assert foreign["message"] == "two\nlines"
    assert "careful" in warned["message"]


def test_the_server_shows_no_handshakes_even_when_debugging() -> None:
    assert server_log_level(Settings(log_level="debug")) == "info"
    assert server_log_level(Settings(log_level="error")) == "error"
