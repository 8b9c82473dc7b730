"""Tables of numbers: which columns are taken, and which line is named when one is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.fault import DatasetError
from model_export.datasets.table import read_table

pytestmark = pytest.mark.torch

Written = Callable[[str], Path]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def write(text: str) -> Path:
        path = tmp_path / "table.txt"
        path.write_text(text)
        return path

    return write


def test_columns_by_name_in_the_order_asked_for(written: Written) -> None:
    path = written("x,time,note,y\n1,2,home,3\n4,NaN,away,6\n")
    rows = read_table(path, ("time", "x", "y"), delimiter=",")
    np.testing.assert_array_equal(rows, [[2, 1, 3], [np.nan, 4, 6]])


def test_columns_of_a_file_without_header(written: Written) -> None:
    path = written("% written by hand\n10.0  1 0.5\n\n10.04 1 -0.5 9\n")
    np.testing.assert_array_equal(read_table(path, 3), [[10.0, 1, 0.5], [10.04, 1, -0.5]])


def test_no_more_rows_than_asked_for(written: Written) -> None:
    path = written("a\tb\n1\t2\nthis is\tnever read\n")
    np.testing.assert_array_equal(read_table(path, ("b",), delimiter="\t", max_rows=1), [[2.0]])


@pytest.mark.parametrize(
    ("text", "columns", "says"),
    [
        ("a,b\n1,2\n3,x\n", ("a", "b"), "line 3 column 2 is 'x', which is no number"),
        ("a,b\n1,2\n\n3\n", ("a", "b"), "line 4 has 1 columns, expected at least 2"),
        ("a,c\n1,2\n", ("a", "b"), "line 1 names no column 'b', its columns are a, c"),
        ("a,b\n", ("a", "b"), "holds no row of numbers"),
        ("", ("a",), "holds no row of numbers"),
        ("1,2\n3,\n", 2, "line 2 column 2 is ''"),
    ],
)
def test_the_line_that_is_wrong_is_named(
    written: Written, text: str, columns: tuple[str, ...] | int, says: str
) -> None:
    path = written(text)
    with pytest.raises(DatasetError) as caught:
        read_table(path, columns, delimiter=",")
    assert caught.value.fault.code == "annotation"
    assert str(caught.value).startswith(f"{path}: ")
    assert says in caught.value.fault.detail


def test_a_binary_file_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes(bytes(range(200, 256)) * 10)
    with pytest.raises(DatasetError, match="which is no number"):
        read_table(path, 1)


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        read_table(tmp_path / "absent.txt", 3)
    assert caught.value.fault.code == "missing"
