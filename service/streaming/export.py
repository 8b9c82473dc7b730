"""A session's results as a file: JSON Lines or CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable

from service.streaming.history import HistoryEntry

FORMATS = {"jsonl": "application/jsonl", "csv": "text/csv"}
COLUMNS = ("t_end", "capture_time_ns", "id", "azimuth_deg", "elevation_deg", "confidence", "active")


def export_json_lines(history: Iterable[HistoryEntry]) -> str:
    """One line per result, with the fields of ``result`` that are kept."""
    return "".join(
        json.dumps(
            {
                "t_end": result.t_end,
                "capture_time_ns": result.capture_time_ns,
                "sources": [
                    {
                        "id": point.id,
                        "azimuth_deg": point.azimuth_deg,
                        "elevation_deg": point.elevation_deg,
                        "confidence": point.confidence,
                        "active": point.active,
                    }
                    for point in result.points
                ],
            }
        )
        + "\n"
        for result in history
    )


def export_csv(history: Iterable[HistoryEntry]) -> str:
    """A header, then one row per source of every result; results without sources have no row."""
    file = io.StringIO()
    writer = csv.writer(file)
    writer.writerow(COLUMNS)
    for result in history:
        for point in result.points:
            captured = "" if result.capture_time_ns is None else result.capture_time_ns
            place = (result.t_end, captured)
            towards = (point.azimuth_deg, point.elevation_deg)
            writer.writerow((*place, point.id, *towards, point.confidence, int(point.active)))
    return file.getvalue()
