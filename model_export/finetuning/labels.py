"""Labels of recordings: who spoke when, and from where.

``labels.csv`` beside the recordings has one row per talker,

    file,azimuth_deg,start_s,end_s
    front.wav,0,,
    both.wav,30,0,4.5
    both.wav,200,2,6

where the times are optional: a row without them holds for the whole recording. Without a
``labels.csv`` every recording needs a JSON sidecar of the same name, such as ``simulate`` writes,
whose ``azimuth_deg`` is a number or a list. Azimuths are degrees counter-clockwise from the array's
+x axis, -180 to 360; in memory they are radians in [0, 2 pi).
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

LABELS = "labels.csv"
COLUMNS = ("file", "azimuth_deg", "start_s", "end_s")
AUDIO_SUFFIXES = frozenset({".wav", ".flac", ".ogg", ".aiff", ".aif", ".caf", ".w64", ".rf64"})
"""Suffixes of recordings, used to find unlabelled ones in a folder"""


@dataclass(frozen=True, slots=True)
class Talker:
    """One talker of a recording."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    start: float = 0.0
    """Seconds"""
    end: float = math.inf
    """Seconds; infinity is the recording's end"""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a recording throughout which the same talkers are labelled."""

    start: float
    """Seconds"""
    end: float
    """Seconds"""
    azimuth: tuple[float, ...]
    """Azimuths of the talkers in radians"""


def read_labels(folder: Path) -> dict[Path, list[Talker]]:
    """Talkers of every recording in a folder, by the recording's path, sorted.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist, or a label names a missing recording.
    ValueError
        If a recording has no label, or a label is wrong; the message names file and line.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder: name the folder of the recordings")
    recordings = {
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in AUDIO_SUFFIXES and not path.name.startswith(".")
    }
    table = folder / LABELS
    labels = _read_table(table) if table.exists() else _read_sidecars(folder, recordings)
    for path in labels:
        if not path.is_file():
            place = table if table.exists() else path.with_suffix(".json")
            raise FileNotFoundError(f"{place} labels {path.name}, but there is no such recording")
    unlabelled = sorted(recordings - labels.keys())
    if unlabelled:
        raise ValueError(
            f"{unlabelled[0].relative_to(folder)} has no label ({len(unlabelled)} of "
            f"{len(recordings)} recordings): add a row to {LABELS}, or move it out of the folder"
        )
    if not labels:
        raise ValueError(f"{folder} holds no recordings: {_forms()}")
    return dict(sorted(labels.items()))


def segments(talkers: Sequence[Talker], duration: float) -> list[Segment]:
    """Parts of a recording with the same labelled talkers, without parts that have none.

    Raises ValueError if a time is beyond the recording's end.
    """
    for talker in talkers:
        latest = talker.start if math.isinf(talker.end) else talker.end
        if latest > duration + 0.1:  # times read off an editor are rounded
            raise ValueError(
                f"a label holds until {latest:g} s, but the recording lasts {duration:.2f} s"
            )
    edges = sorted({min(t, duration) for talker in talkers for t in (talker.start, talker.end)})
    found = []
    for start, end in pairwise(edges):
        active = tuple(t.azimuth for t in talkers if t.start <= start and t.end >= end)
        if active:
            found.append(Segment(start, end, active))
    return found


def _forms() -> str:
    return (
        f"put {LABELS} with the header {','.join(COLUMNS[:2])} and a row per talker beside them, "
        "or a JSON file <name>.json with azimuth_deg beside each"
    )


def _read_table(path: Path) -> dict[Path, list[Talker]]:
    labels: dict[Path, list[Talker]] = {}
    # utf-8-sig: spreadsheets put a byte order mark before the header.
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file, skipinitialspace=True)
        try:
            _check_header(path, rows.fieldnames or ())
            for row in rows:
                place = f"{path} line {rows.line_num}"
                talker = _talker(place, row)
                talkers = labels.setdefault(path.parent / row["file"], [])
                if talker in talkers:
                    raise ValueError(f"{place} repeats an earlier row")
                talkers.append(talker)
        except (csv.Error, UnicodeDecodeError) as error:
            raise ValueError(f"{path} line {rows.line_num + 1} is no CSV text: {error}") from None
    return labels


def _check_header(path: Path, header: Sequence[str]) -> None:
    if set(COLUMNS[:2]) <= set(header) <= set(COLUMNS):
        return
    raise ValueError(
        f"{path} line 1: the header must be {','.join(COLUMNS[:2])} or {','.join(COLUMNS)}, "
        f"separated by commas, but is {','.join(header)!r}"
    )


def _talker(place: str, row: Mapping[str | None, Any]) -> Talker:
    # DictReader puts surplus fields under None and gives None for missing ones.
    if None in row or row["azimuth_deg"] is None or not row["file"]:
        raise ValueError(f"{place}: write {','.join(COLUMNS[:2])}, with a value for each")
    start = _number(place, "start_s", row.get("start_s") or "0")
    end = _number(place, "end_s", row.get("end_s") or "inf")
    if not 0 <= start < end:
        raise ValueError(f"{place}: start_s is {start:g} and end_s {end:g}: give 0 <= start < end")
    return Talker(_azimuth(place, row["azimuth_deg"]), start, end)


def _number(place: str, name: str, text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        raise ValueError(f"{place}: {name} is {text!r}, which is no number") from None


def _azimuth(place: str, degrees: Any) -> float:
    value = _number(place, "azimuth_deg", degrees)
    if not -180 <= value <= 360:  # False for NaN, too
        raise ValueError(
            f"{place}: azimuth_deg is {value:g}, but must lie between -180 and 360 degrees, "
            "counter-clockwise from the array's +x axis"
        )
    return math.radians(value) % (2 * math.pi)


def _read_sidecars(folder: Path, recordings: set[Path]) -> dict[Path, list[Talker]]:
    by_sidecar = {path.with_suffix(".json"): path for path in recordings}
    labels = {}
    for sidecar in sorted(folder.rglob("*.json")):
        azimuths = _sidecar_azimuths(sidecar)
        # JSON files of other kinds, such as an array's geometry, may lie in the folder.
        if azimuths is not None:
            path = by_sidecar.get(sidecar, sidecar.with_suffix(".wav"))
            labels[path] = [Talker(_azimuth(str(sidecar), value)) for value in azimuths]
    return labels


def _sidecar_azimuths(sidecar: Path) -> list[Any] | None:
    """The values of ``azimuth_deg`` in the file, or None if it has none."""
    try:
        fields = json.loads(sidecar.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{sidecar} is no JSON text: {error}") from None
    if not isinstance(fields, dict) or "azimuth_deg" not in fields:
        return None
    azimuths = fields["azimuth_deg"]
    azimuths = azimuths if isinstance(azimuths, list) else [azimuths]
    if not azimuths:
        raise ValueError(f"{sidecar}: azimuth_deg is empty: name at least one talker's direction")
    return azimuths
