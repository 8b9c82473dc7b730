"""A result as Parquet: a row for every source of every window, for pandas, polars and SQL.

A Parquet file is complete only once it is finished. Until then records are kept as JSON Lines
beside it, and an interrupted run continues from there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from neuralmusic.errors import ConfigError, InvalidOption
from service.batch.archive import FoundRecording, Key
from service.batch.jsonl import JsonLinesResult
from service.batch.plan import Plan
from service.batch.record import AGAIN, Record, key_of

METADATA = b"neuralmusic"
"""Key of the file's metadata: JSON with the options and models of all its recordings"""
ROW_GROUP = 65_536
"""Most rows held in memory while the file is written"""
KEY = ["path", "size_bytes", "modified_ms"]
COLUMNS = {
    "path": "string",
    "size_bytes": "int64",
    "modified_ms": "int64",
    "sample_rate": "int32",
    "channels": "int16",
    "duration_s": "float64",
    "window": "int32",
    "t_start": "float64",
    "t_end": "float64",
    "num_sources": "int8",
    "id": "int32",
    "azimuth_deg": "float64",
    "confidence": "float64",
    "warnings": "string",
    "error_code": "string",
    "error_detail": "string",
}
"""Columns; null from ``sample_rate`` on where a recording failed, from ``id`` on in silence"""


class ParquetResult:
    """A Parquet file, and beside it the records not yet in it.

    Parameters
    ----------
    path : Path
        Read if there is one; written by ``finish``.

    Raises
    ------
    ConfigError
        If pyarrow is not installed.
    InvalidOption
        If the file is not a result of this plan, or another run writes it.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        self._arrow, self._parquet = _pyarrow()
        self._path = path
        self._plan = plan
        self._stale: set[Key] = set()
        self._codes = self._read() if path.exists() else {}
        self._fresh = JsonLinesResult(beside(path), plan)

    def remaining(self, found: Sequence[FoundRecording]) -> list[FoundRecording]:
        """The recordings still to do: those without rows or records, and changed ones."""
        now = {recording.path: recording.key for recording in found}
        self._stale = {
            key
            for key, code in self._codes.items()
            if key[0] in now and (key != now[key[0]] or code in AGAIN)
        }
        for key in self._stale:
            del self._codes[key]
        return self._fresh.remaining([each for each in found if each.key not in self._codes])

    def append(self, record: Record) -> None:
        """Keep a record for ``finish``."""
        self._fresh.append(record)

    def errors(self, found: Sequence[FoundRecording]) -> list[str]:
        """The error codes of those recordings that have no answer."""
        written = (self._codes.get(recording.key) for recording in found)
        return [code for code in written if code is not None] + self._fresh.errors(found)

    def finish(self) -> None:
        """Rewrite the file with the new records, and delete the records beside it."""
        if self._stale or self._fresh.path.stat().st_size or not self._path.exists():
            self._write()
        self._fresh.path.unlink()

    def close(self) -> None:
        """Let other runs write the file."""
        self._fresh.close()

    def _write(self) -> None:
        new = self._path.with_name(self._path.name + ".new")
        with self._parquet.ParquetWriter(new, self._schema(), compression="zstd") as writer:
            for batch in self._kept():
                writer.write_batch(batch)
            for rows in _groups(self._fresh_rows()):
                writer.write_table(self._arrow.Table.from_pylist(rows, self._schema()))
        os.replace(new, self._path)

    def _read(self) -> dict[Key, str | None]:
        """The recordings in the file, with their error codes."""
        try:
            with self._parquet.ParquetFile(self._path) as file:
                metadata = (file.schema_arrow.metadata or {}).get(METADATA)
                if metadata is None:
                    raise InvalidOption(
                        f"{self._path} is not a result of neuralmusic batch: name another --out"
                    )
                self._plan.check(json.loads(metadata), str(self._path))
                keys = file.read([*KEY, "error_code"])
        except self._arrow.ArrowInvalid as error:
            raise InvalidOption(
                f"{self._path} cannot be read as Parquet: name another --out"
            ) from error
        rows = keys.group_by(keys.column_names).aggregate([]).to_pylist()
        return {_key(row): row["error_code"] for row in rows}

    def _schema(self) -> Any:
        types = [(name, self._arrow.type_for_alias(alias)) for name, alias in COLUMNS.items()]
        array = self._plan.job.asked.options.array
        described = {
            **self._plan.identity,
            "array": {"name": array.name, "positions_m": array.positions.tolist()},
        }
        return self._arrow.schema(types, metadata={METADATA: json.dumps(described)})

    def _kept(self) -> Iterator[Any]:
        """The rows to keep of the file, batch by batch."""
        if not self._path.exists():
            return
        with self._parquet.ParquetFile(self._path) as file:
            for batch in file.iter_batches(ROW_GROUP):
                rows = batch.select(KEY).to_pylist() if self._stale else ()
                keep = [_key(row) not in self._stale for row in rows]
                yield batch.filter(self._arrow.array(keep)) if rows else batch

    def _fresh_rows(self) -> Iterator[dict[str, Any]]:
        for record in self._fresh.records():
            # A run that was interrupted between the last two steps of ``finish`` leaves both.
            if key_of(record) not in self._codes:
                yield from rows_of(record)


def rows_of(record: Record) -> Iterator[dict[str, Any]]:
    """The rows of a recording: one a source, one for a silent window, one where there is none."""
    row: dict[str, Any] = {**dict.fromkeys(COLUMNS), **{name: record[name] for name in KEY}}
    if record["error"]:
        yield {**row, **{f"error_{name}": text for name, text in record["error"].items()}}
        return
    row |= record["audio"]
    row["warnings"] = ",".join(warning["code"] for warning in record["warnings"])
    if not record["windows"]:  # a few samples that resampling reduced to none
        yield row
    for index, window in enumerate(record["windows"]):
        place = {name: window[name] for name in ("t_start", "t_end", "num_sources")}
        heard: Iterable[dict[str, Any]] = window["sources"] or ({},)
        for source in heard:
            told = {name: source.get(name) for name in ("id", "azimuth_deg", "confidence")}
            yield {**row, "window": index, **place, **told}


def _groups(rows: Iterable[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    """Lists of at most ``ROW_GROUP`` rows."""
    left = iter(rows)
    while group := list(islice(left, ROW_GROUP)):
        yield group


def _key(row: dict[str, Any]) -> Key:
    return row["path"], row["size_bytes"], row["modified_ms"]


def beside(path: Path) -> Path:
    """Path of the records that are not yet in a Parquet file."""
    return path.with_name(path.name + ".jsonl")


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError(
            "a Parquet result needs pyarrow: pip install ./client '.[parquet]' in the project's "
            "folder, or name the --out .jsonl"
        ) from None
    return pyarrow, pyarrow.parquet
