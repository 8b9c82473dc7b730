"""A session's results as files."""

from __future__ import annotations

import csv
import io
import json

from service.streaming.export import export_csv, export_json_lines
from service.streaming.history import HistoryEntry, Point

HISTORY = (
    HistoryEntry(0.5, 7_000_000_000, (Point(1, 12.5, 0.9, True), Point(2, 200.0, 0.4, False))),
    HistoryEntry(0.6, None, ()),
    HistoryEntry(0.7, None, (Point(1, 13.0, 0.8, True),)),
)


def test_a_table_has_a_row_for_every_source() -> None:
    rows = list(csv.DictReader(io.StringIO(export_csv(HISTORY))))
    assert [(row["t_end"], row["id"], row["azimuth_deg"]) for row in rows] == [
        ("0.5", "1", "12.5"),
        ("0.5", "2", "200.0"),
        ("0.7", "1", "13.0"),
    ]
    assert [row["capture_time_ns"] for row in rows] == ["7000000000", "7000000000", ""]
    assert [row["active"] for row in rows] == ["1", "0", "1"]


def test_lines_hold_results_without_sources_too() -> None:
    lines = [json.loads(line) for line in export_json_lines(HISTORY).splitlines()]
    assert [(line["t_end"], len(line["sources"])) for line in lines] == [
        (0.5, 2),
        (0.6, 0),
        (0.7, 1),
    ]
    assert lines[0]["sources"][1] == {
        "id": 2,
        "azimuth_deg": 200.0,
        "elevation_deg": None,
        "confidence": 0.4,
        "active": False,
    }
