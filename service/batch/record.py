"""What a run writes down of one recording: the HTTP interface's answer, or why there is none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from service.api.schemas import LocalizationAnswer
from service.audio import Recording
from service.batch.archive import FoundRecording, Key
from service.batch.plan import Plan
from service.errors import DoaError, RecordingUnreadable, WorkerLost
from service.inference.recording import localize_recording

Record = dict[str, Any]
"""JSON: path, size_bytes, modified_ms, error, options, method, model; then the other fields of
``LocalizationAnswer`` where error is null"""

AGAIN = frozenset({RecordingUnreadable.code, WorkerLost.code})
"""Errors that may pass: these recordings are tried again"""


class RecordingLocalizer:
    """Turns recordings into records; one per process, which loads the bundles once.

    Raises
    ------
    BundleError, ConfigError
        If the bundles cannot be loaded, or are others than where the plan was made.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._registry = plan.load()

    def record(
        self, found: FoundRecording, progress: Callable[[float], None] | None = None
    ) -> Record:
        """Localize one recording; whatever is wrong with it is its record."""
        plan = self._plan
        try:
            with Recording.open(found.place, plan.limits) as recording:
                result = localize_recording(recording, plan.options, self._registry, progress)
        except DoaError as error:
            return failed(found, plan, error)
        except OSError as error:
            return failed(found, plan, RecordingUnreadable(_unreadable(error)))
        except Exception as error:  # a defect must not end a run of days
            return failed(found, plan, DoaError(f"{type(error).__name__}: {error}"))
        answer = LocalizationAnswer.of(result).model_dump(mode="json", exclude_unset=True)
        return {**_head(found, plan), **answer}


def failed(found: FoundRecording, plan: Plan, error: DoaError) -> Record:
    """The record of a recording that could not be localized."""
    return {**_head(found, plan), "error": {"code": error.code, "detail": error.detail}}


def key_of(record: Record) -> Key:
    """As ``FoundRecording.key``."""
    return record["path"], record["size_bytes"], record["modified_ms"]


def error_code(record: Record) -> str | None:
    """Why there is no answer, or None where there is one."""
    return record["error"]["code"] if record["error"] else None


def _head(found: FoundRecording, plan: Plan) -> Record:
    path, size, modified = found.key
    place = {"path": path, "size_bytes": size, "modified_ms": modified}
    return {**place, "error": None, **plan.identity}


def _unreadable(error: OSError) -> str:
    return (
        f"{error.strerror or error}: the file must be readable where it is localized, "
        "then run the same command again"
    )
