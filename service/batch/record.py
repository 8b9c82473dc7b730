"""What a run writes about one recording: the HTTP interface's answer, or an error."""

from __future__ import annotations

from typing import Any

from pydantic_core import from_json

from neuralmusic.errors import DoaError, RecordingUnreadable, WorkerLost
from service.batch.archive import FoundRecording, Key
from service.batch.plan import Plan
from service.recordings.job import Localized

Record = dict[str, Any]
"""JSON: path, size_bytes, modified_ms, error, options, method, model; where error is null, the
other fields of ``LocalizationAnswer`` follow"""

AGAIN = frozenset({RecordingUnreadable.code, WorkerLost.code})
"""Transient errors: these recordings are tried again"""


def localized(found: FoundRecording, plan: Plan, answer: Localized) -> Record:
    """The record of a recording with its answer."""
    return {**_head(found, plan), **from_json(answer.body)}


def failed(found: FoundRecording, plan: Plan, error: DoaError) -> Record:
    """The record of a recording that could not be localized."""
    return {**_head(found, plan), "error": {"code": error.code, "detail": error.detail}}


def key_of(record: Record) -> Key:
    """The key of a record's recording, as ``FoundRecording.key``."""
    return record["path"], record["size_bytes"], record["modified_ms"]


def error_code(record: Record) -> str | None:
    """The error code of a record, or None where it has an answer."""
    return record["error"]["code"] if record["error"] else None


def _head(found: FoundRecording, plan: Plan) -> Record:
    path, size, modified = found.key
    place = {"path": path, "size_bytes": size, "modified_ms": modified}
    return {**place, "error": None, **plan.identity}
