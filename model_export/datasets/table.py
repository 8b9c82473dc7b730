"""Annotations in text files: columns of numbers, with or without a header."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from model_export.datasets.fault import REMEDY, DatasetError, require
from service.doa.types import FloatArray, IntArray

COMMENTS = ("#", "%")


def read_table(
    path: Path,
    columns: Sequence[str] | int,
    *,
    delimiter: str | None = None,
    max_rows: int | None = None,
) -> FloatArray:
    """Read the numbers of a text file.

    Parameters
    ----------
    columns : names or int
        Names, in the first line, of the columns to read; or, for a file without a header, the
        number of columns to read.
    delimiter : str, optional
        Separator of columns; by default any white space.
    max_rows : int, optional
        Number of lines to read; by default all.

    Returns
    -------
    rows : (K, C) float64
        One row or more; NaN where the file says NaN.

    Raises
    ------
    DatasetError
        If the file is missing or empty, a column is missing, or a row is no list of numbers; the
        message names the line.
    """
    require(path, REMEDY)
    header = not isinstance(columns, int)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = list(islice(file, None if max_rows is None else max_rows + header))
    first = 1 if header else 0
    rows = [
        (number, line)
        for number, line in enumerate(lines[first:], first + 1)
        if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    if not rows:
        raise DatasetError("annotation", path, f"holds no row of numbers: {REMEDY}")
    if isinstance(columns, int):
        wanted = list(range(columns))
    else:
        wanted = _places(path, lines[0], columns, delimiter)
    try:
        return np.loadtxt([line for _, line in rows], delimiter=delimiter, usecols=wanted, ndmin=2)
    except ValueError:
        raise _fault(path, rows, wanted, delimiter) from None


def sorted_times(path: Path, times: FloatArray) -> FloatArray:
    """The times (K,) in seconds; DatasetError if one is not finite or they run backwards."""
    if not np.isfinite(times).all():
        raise DatasetError("annotation", path, f"a time is no number: {REMEDY}")
    backwards: IntArray = np.flatnonzero(np.diff(times) < 0)
    if backwards.size:
        row = int(backwards[0]) + 2
        raise DatasetError("annotation", path, f"the time of row {row} runs backwards: {REMEDY}")
    return times


def _places(path: Path, header: str, columns: Sequence[str], delimiter: str | None) -> list[int]:
    names = [name.strip() for name in header.strip().split(delimiter)]
    missing = [name for name in columns if name not in names]
    if missing:
        raise DatasetError(
            "annotation",
            path,
            f"line 1 names no column {missing[0]!r}, its columns are {', '.join(names)[:200]}: "
            f"{REMEDY}",
        )
    return [names.index(name) for name in columns]


def _fault(
    path: Path, rows: Sequence[tuple[int, str]], wanted: Sequence[int], delimiter: str | None
) -> DatasetError:
    """The first line that is wrong and its problem, which the parser does not name."""
    for number, line in rows:
        fields = line.strip().split(delimiter)
        if len(fields) <= max(wanted):
            problem = f"has {len(fields)} columns, expected at least {max(wanted) + 1}"
            return DatasetError("annotation", path, f"line {number} {problem}: {REMEDY}")
        for place in wanted:
            try:
                float(fields[place])
            except ValueError:
                problem = f"column {place + 1} is {fields[place][:40]!r}, which is no number"
                return DatasetError("annotation", path, f"line {number} {problem}: {REMEDY}")
    return DatasetError("annotation", path, f"is no table of numbers: {REMEDY}")
