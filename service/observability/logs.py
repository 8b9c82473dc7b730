"""Logs for people or as JSON, with the ids of the request and the stream.

Nothing that came over the wire can begin a line of its own, and no key is ever written.
"""

from __future__ import annotations

import json
import logging
import re
import sys
import time
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from service.settings import Settings

request_id: ContextVar[str | None] = ContextVar("request_id", default=None)
"""Id of the request being answered, in its threads, too"""
session_id: ContextVar[str | None] = ContextVar("session_id", default=None)
"""Id of the stream being served"""

PACKAGE = "service"
SAID = ("method", "path", "status", "reason")
"""Fields already told in the message of a line"""
HIDDEN = "[hidden]"
_KEYS = re.compile(r"(bearer[ .:=]+)[A-Za-z0-9._~+/=-]+", re.IGNORECASE)
"""Keys as clients send them: ``Authorization: Bearer KEY`` and the subprotocol ``bearer.KEY``"""
_PLAIN = re.compile(r"[^\s\"=\\]*")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_OWN = frozenset({*logging.makeLogRecord({}).__dict__, "message", "taskName", "color_message"})
"""Attributes of every log record; further ones are fields of the line"""


def configure_logging(settings: Settings, worker: str | None = None) -> None:
    """Log to standard error in the format of the settings; for the process that owns it.

    Parameters
    ----------
    worker : str, optional
        Name of a worker process, shown in all its lines.
    """
    handler = logging.StreamHandler(sys.stderr)
    formatter = JsonFormatter if settings.log_format == "json" else TextFormatter
    handler.setFormatter(formatter(worker))
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger(PACKAGE).setLevel(settings.log_level.upper())
    logging.captureWarnings(True)


def server_log_level(settings: Settings) -> str:
    """uvicorn's level, above ``debug``, which would show handshakes with all their headers."""
    return "info" if settings.log_level == "debug" else settings.log_level


def _ids(worker: str | None) -> dict[str, Any]:
    """The known ids of a line: worker, request, stream, span."""
    known: dict[str, Any] = {
        "request_id": request_id.get(),
        "session_id": session_id.get(),
        "worker": worker,
        **_span_ids(),
    }
    return {name: value for name, value in known.items() if value is not None}


def _span_ids() -> dict[str, str]:
    """The ids of the current span, without importing OpenTelemetry for it."""
    trace = sys.modules.get("opentelemetry.trace")
    context = trace.get_current_span().get_span_context() if trace else None
    if context is None or not context.is_valid:
        return {}
    return {"trace_id": f"{context.trace_id:032x}", "span_id": f"{context.span_id:016x}"}


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    return {name: value for name, value in record.__dict__.items() if name not in _OWN}


class RareLine:
    """A warning that whoever attacks can cause at will: written once a minute."""

    def __init__(self, log: logging.Logger, every_s: float = 60.0) -> None:
        self._log = log
        self._every_s = every_s
        self._next = 0.0
        self._unsaid = 0

    def warning(self, text: str, *values: object) -> None:
        """Write it with how often it was not, or count it."""
        now = time.monotonic()
        if now < self._next:
            self._unsaid += 1
            return
        self._log.warning(text + " (%d more since the last such line)", *values, self._unsaid)
        self._next, self._unsaid = now + self._every_s, 0


class WorkerFormatter(logging.Formatter):
    """Lines that name their process where it is a worker."""

    def __init__(self, worker: str | None = None) -> None:
        super().__init__()
        self._worker = worker


class JsonFormatter(WorkerFormatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        created = datetime.fromtimestamp(record.created, UTC)
        line: dict[str, Any] = {
            "ts": created.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage().strip(),
            **_ids(self._worker),
            **_fields(record),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        # ASCII alone: some readers take Unicode separators for the end of a line.
        return _without_keys(json.dumps(line, default=str))


class TextFormatter(WorkerFormatter):
    """One line for people; only a traceback takes more lines."""

    def format(self, record: logging.LogRecord) -> str:
        clock = f"{self.formatTime(record, '%H:%M:%S')}.{record.msecs:03.0f}"
        named = {**_ids(self._worker), **_fields(record)}
        told = " ".join(f"{key}={_quoted(each)}" for key, each in named.items() if key not in SAID)
        line = f"{clock} {record.levelname:<8} {record.getMessage().strip()}  {told}".rstrip()
        line = one_line(line)
        if record.exc_info:
            line += "\n" + self.formatException(record.exc_info)
        return _without_keys(line)


def _quoted(value: object) -> str:
    """A value that no other field can be read out of."""
    text = str(value)
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=False)


def one_line(text: str) -> str:
    """``text`` with its control characters escaped."""
    return _CONTROL.sub(lambda found: f"\\x{ord(found.group()):02x}", text)


def _without_keys(text: str) -> str:
    return _KEYS.sub(rf"\1{HIDDEN}", text)
