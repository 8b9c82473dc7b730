"""A result as JSON Lines: one record a line, on disk as soon as its recording is done."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from pydantic_core import from_json, to_json

from neuralmusic.errors import InvalidOption
from service.batch.archive import FoundRecording, Key
from service.batch.plan import Plan
from service.batch.record import AGAIN, Record, error_code, key_of

BEGINNING = b'{"path":'
"""First bytes of a record's line; an interrupted run may leave the line unfinished"""


class JsonLinesResult:
    """A file with a line for every record; one run at a time writes it.

    Parameters
    ----------
    path : Path
        Created if there is none. A line that an interrupted run left half-written is cut off.

    Raises
    ------
    InvalidOption
        If the file is not a result of this plan, or another run writes it.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        self.path = path
        self._plan = plan
        self._codes: dict[Key, str | None] = {}
        """Error code of every record, None where it has an answer"""
        self._file = _locked(path)
        try:
            self._end = self._check()
        except BaseException:
            self._file.close()
            raise
        self._file.truncate(self._end)
        self._file.seek(self._end)

    def remaining(self, found: Sequence[FoundRecording]) -> list[FoundRecording]:
        """The recordings still to do: new and changed ones, and errors that may pass now."""
        now = {recording.path: recording.key for recording in found}
        stale = {
            key
            for key, code in self._codes.items()
            if key[0] in now and (key != now[key[0]] or code in AGAIN)
        }
        if stale:
            self._rewrite_without(stale)
        return [recording for recording in found if recording.key not in self._codes]

    def append(self, record: Record) -> None:
        """Write a record."""
        self._file.write(to_json(record) + b"\n")
        self._file.flush()
        self._codes[key_of(record)] = error_code(record)

    def records(self) -> Iterator[Record]:
        """All records so far, in the order in which they were done."""
        with self.path.open("rb") as file:
            for line in file:
                yield from_json(line)

    def errors(self, found: Sequence[FoundRecording]) -> list[str]:
        """The error codes of those recordings that have no answer."""
        codes = (self._codes.get(recording.key) for recording in found)
        return [code for code in codes if code is not None]

    def finish(self) -> None:
        """Do nothing: every record is in the file already."""

    def close(self) -> None:
        """Let other runs write the file."""
        self._file.close()

    def _check(self) -> int:
        """Check every line; return where the last whole one ends."""
        end = 0
        self._file.seek(0)
        for number, line in enumerate(self._file, 1):
            if not line.endswith(b"\n") and line.startswith(BEGINNING[: len(line)]):
                break
            try:
                record = from_json(line)
                self._codes[key_of(record)] = error_code(record)
            except (ValueError, KeyError, TypeError):
                raise InvalidOption(
                    f"line {number} of {self.path} is not a record of neuralmusic batch: name "
                    "another --out"
                ) from None
            self._plan.check(record, str(self.path))
            end += len(line)
        return end

    def _rewrite_without(self, stale: set[Key]) -> None:
        new = _locked(self.path.with_name(self.path.name + ".new"))
        new.truncate(0)
        for record in self.records():
            if key_of(record) not in stale:
                new.write(to_json(record) + b"\n")
        new.flush()
        os.replace(new.name, self.path)
        self._file.close()
        self._file = new
        for key in stale:
            del self._codes[key]


def _locked(path: Path) -> BinaryIO:
    file = path.open("a+b")
    with suppress(ImportError):  # not on every system
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InvalidOption(
                f"another run is writing {path}: wait for it, or name another --out"
            ) from None
    return file
