"""A localized recording as text: directions over time, summary and warnings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console

from neuralmusic.cli.terminal import line, output, table, warn
from neuralmusic.cli.words import clock, direction, sector
from service.doa.kalman import angle
from service.doa.kalman import direction as towards
from service.inference.results import Source
from service.recordings.results import RecordingResult, WindowResult

SAME = math.radians(10.0)  # consecutive windows whose sources moved less are one row


@dataclass(slots=True)
class Interval:
    """Consecutive windows with the same sources."""

    t_start: float
    t_end: float
    windows: list[tuple[Source, ...]]


def print_result(result: RecordingResult) -> None:
    """Print a table of directions over time, the summary and the warnings."""
    console = output()
    line(console, _heading(result), "bold")
    drawn = table(console, "from", "to", "directions (confidence)", right=("from", "to"))
    for stretch in stretches(result.windows):
        drawn.add_row(clock(stretch.t_start), clock(stretch.t_end), _directions(stretch))
    console.print(drawn)
    _print_summary(console, result)
    for warning in result.warnings:
        warn(console, warning.code, warning.detail)


def stretches(windows: Sequence[WindowResult]) -> list[Interval]:
    """Merge consecutive windows whose sources stay within 10 degrees of the stretch's first.

    Windows overlap, so a stretch ends where the next one begins.
    """
    merged: list[Interval] = []
    for window in windows:
        sources = _by_azimuth(window.estimate.sources)
        if merged and _same(merged[-1].windows[0], sources):
            merged[-1].windows.append(sources)
        else:
            if merged:
                merged[-1].t_end = min(merged[-1].t_end, window.t_start)
            merged.append(Interval(window.t_start, window.t_end, [sources]))
        merged[-1].t_end = window.t_end
    return merged


def _by_azimuth(sources: Sequence[Source]) -> tuple[Source, ...]:
    return tuple(sorted(sources, key=lambda source: source.azimuth))


def _same(first: Sequence[Source], second: Sequence[Source]) -> bool:
    """Whether the sources agree in some circular order: 359 and 1 degrees are neighbours."""
    if len(first) != len(second):
        return False
    turns = range(max(len(second), 1))
    return any(
        all(_apart(a, second[(i + turn) % len(second)]) < SAME for i, a in enumerate(first))
        for turn in turns
    )


def _apart(one: Source, other: Source) -> float:
    """Angle between two sources in radians."""
    return angle(towards(one.azimuth, one.elevation), towards(other.azimuth, other.elevation))


def _directions(stretch: Interval) -> str:
    """The sources of the stretch's most confident window, each with its sector."""
    sources = max(stretch.windows, key=lambda window: sum(s.confidence for s in window))
    if not sources:
        return "-"
    return ", ".join(
        f"{direction(s.azimuth, s.elevation)} {sector(s.azimuth)} ({s.confidence:.2f})"
        for s in sorted(sources, key=lambda source: -source.confidence)
    )


def _heading(result: RecordingResult) -> str:
    by = f"{result.model.name} {result.model.version}" if result.model else result.method
    return (
        f"{result.duration:.1f} s of {result.array.name} "
        f"(channels {', '.join(map(str, result.channel_map))}) by {by}"
    )


def _print_summary(console: Console, result: RecordingResult) -> None:
    if not result.summary:
        line(console, "no sources")
        return
    columns = ("share", "confidence")
    drawn = table(console, "direction", "", *columns, right=("direction", *columns))
    for source in result.summary:
        drawn.add_row(
            direction(source.azimuth, source.elevation),
            sector(source.azimuth),
            f"{source.share:.0%}",
            f"{source.confidence:.2f}",
        )
    console.print(drawn)
