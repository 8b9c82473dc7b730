"""Panels of a Grafana dashboard, drawn by matplotlib in the dashboard's own layout.

Only what ``docker/grafana/dashboards/neuralmusic.json`` uses: rows, time series, stats, tables.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

COLUMNS = 24
CELL_IN = (0.72, 0.36)
"""Width and height of a cell of the grid, inches"""
HEADER_IN = 0.7
INK, MUTED, LINE, PAPER, GROUND = "#1d2129", "#6b7280", "#e3e6ea", "#ffffff", "#f4f5f7"
PALETTE = (
    *("#3f7fbf", "#d9822b", "#2f9e6e", "#c2413b", "#7a5fb5", "#8a6d3b"),
    *("#d16ba5", "#5b6770", "#a3a635", "#2aa5b8"),
)
NAMED = {"green": "#2f9e6e", "yellow": "#c99700", "red": "#c2413b", "blue": "#3f7fbf"}


@dataclass(frozen=True, slots=True)
class Series:
    """One line of a panel."""

    name: str
    times: list[float]
    """Seconds from the beginning of the picture"""
    values: list[float]
    labels: dict[str, str]


def written(value: float, unit: str) -> str:
    """A value as Grafana would write it in this unit."""
    if math.isnan(value):
        return "–"
    if unit == "s" and abs(value) < 1:
        return f"{1000 * value:.3g} ms"
    if unit == "percentunit":
        return f"{100 * value:.3g} %"
    if unit == "bytes":
        return f"{value / 2**20:.0f} MiB"
    suffix = {"s": " s", "cps": "/s", "reqps": "/s"}.get(unit, "")
    return f"{value:.3g}{suffix}"


def draw(
    dashboard: Any, shown: dict[int, list[Series]], title: str, seconds: float, path: Path
) -> None:
    """Write all panels into one picture.

    Parameters
    ----------
    shown : dict
        The series of every panel by its id.
    seconds : float
        Width of all time axes.
    """
    rows = max(panel["gridPos"]["y"] + panel["gridPos"]["h"] for panel in dashboard["panels"])
    width, height = COLUMNS * CELL_IN[0], rows * CELL_IN[1] + HEADER_IN
    figure = plt.figure(figsize=(width, height), facecolor=GROUND)
    figure.text(0.012, 1 - 0.2 / height, dashboard["title"], size=15, weight="bold", va="top")
    figure.text(0.012, 1 - 0.47 / height, title, size=8.5, color=MUTED, va="top")
    for panel in dashboard["panels"]:
        place = panel["gridPos"]
        left, right = place["x"] / COLUMNS, (place["x"] + place["w"]) / COLUMNS
        top = 1 - (HEADER_IN + place["y"] * CELL_IN[1]) / height
        bottom = top - place["h"] * CELL_IN[1] / height
        if panel["type"] == "row":
            figure.text(0.012, bottom + 0.06 / height, panel["title"], size=11, weight="bold")
            continue
        _card(figure, (left, bottom, right, top), panel["title"])
        frame = _frame(panel["type"], (left, bottom, right, top), width, height)
        axes = figure.add_axes(frame)
        {"timeseries": _time_series, "stat": _stat, "table": _table}[panel["type"]](
            axes, panel, shown[panel["id"]], seconds
        )
    figure.savefig(path, dpi=80, facecolor=GROUND)
    plt.close(figure)


Box = tuple[float, float, float, float]


def _card(figure: Figure, box: Box, title: str) -> None:
    left, bottom, right, top = box
    gap = 0.0025
    figure.patches.append(
        plt.Rectangle(
            (left + gap, bottom + gap / 2),
            right - left - 2 * gap,
            top - bottom - gap,
            transform=figure.transFigure,
            facecolor=PAPER,
            edgecolor=LINE,
            linewidth=0.8,
            zorder=-1,
        )
    )
    height = figure.get_figheight()
    figure.text(left + 0.008, top - 0.1 / height, title, size=8.5, weight="bold", va="top")


def _frame(kind: str, box: Box, width: float, height: float) -> Box:
    """Left, bottom, width and height of a panel's axes."""
    left, bottom, right, top = box
    inset = {  # inches: left, bottom, right, top
        "timeseries": (0.62, 0.62, 0.2, 0.36),
        "stat": (0.08, 0.06, 0.08, 0.3),
        "table": (0.12, 0.1, 0.12, 0.36),
    }[kind]
    x, y = left + inset[0] / width, bottom + inset[1] / height
    return (x, y, right - inset[2] / width - x, top - inset[3] / height - y)


def _time_series(axes: Axes, panel: Any, lines: Sequence[Series], seconds: float) -> None:
    defaults = panel["fieldConfig"]["defaults"]
    unit = defaults["unit"]
    lines = [line for line in lines if any(map(math.isfinite, line.values))]
    if "stacking" in defaults["custom"]:
        _stacked(axes, lines)
    else:
        for index, line in enumerate(lines):
            colour = PALETTE[index % len(PALETTE)]
            axes.plot(line.times, line.values, color=colour, linewidth=1.1, label=line.name)
            axes.fill_between(line.times, line.values, color=colour, alpha=0.06, linewidth=0)
    axes.set_xlim(0, seconds)
    if defaults["custom"].get("scaleDistribution", {}).get("type") == "log":
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0)
        if axes.get_ylim()[1] <= 0.06 and unit not in ("s", "percentunit"):
            axes.set_ylim(top=1)
        axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: written(value, unit)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda at, _: f"{at // 60:.0f}:{at % 60:02.0f}"))
    axes.tick_params(labelsize=7, colors=MUTED, length=0)
    axes.grid(color=LINE, linewidth=0.6)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_visible(False)
    columns = min(len(lines), max(2, round(panel["gridPos"]["w"] / 2.6)))
    axes.legend(
        *(axes.get_legend_handles_labels()),
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.1),
        ncols=max(columns, 1),
        fontsize=6.5,
        frameon=False,
        handlelength=1.0,
        columnspacing=1.0,
        labelcolor=INK,
    )


def _stacked(axes: Axes, lines: Sequence[Series]) -> None:
    times = sorted({at for line in lines for at in line.times})
    heights = []
    for line in lines:
        known = dict(zip(line.times, line.values, strict=True))
        heights.append([known.get(at, 0.0) for at in times])
    axes.stackplot(
        times,
        heights,
        labels=[line.name for line in lines],
        colors=[PALETTE[index % len(PALETTE)] for index in range(len(lines))],
        alpha=0.75,
    )


def _stat(axes: Axes, panel: Any, lines: Sequence[Series], seconds: float) -> None:
    defaults = panel["fieldConfig"]["defaults"]
    axes.axis("off")
    share = 1 / len(lines)
    for index, line in enumerate(lines):
        value = next((v for v in reversed(line.values) if not math.isnan(v)), math.nan)
        colour = _colour(defaults, value)
        said = written(value, defaults["unit"])
        if len(lines) > 1:
            said = f"{line.name} {said}"
        at = (index + 0.5) * share
        axes.text(
            at, 0.62, said, size=19, weight="bold", ha="center", va="center", color=colour,
            transform=axes.transAxes,
        )  # fmt: skip
        trend = axes.inset_axes((index * share, 0, share, 0.34))
        trend.fill_between(line.times, line.values, color=colour, alpha=0.18, linewidth=0)
        trend.plot(line.times, line.values, color=colour, linewidth=0.9)
        trend.set_xlim(0, seconds)
        trend.set_ylim(0, max([v for v in line.values if not math.isnan(v)] or [1.0]) * 1.1 or 1)
        trend.axis("off")


def _colour(defaults: Any, value: float) -> str:
    colour = defaults["color"].get("fixedColor", "green")
    for step in defaults.get("thresholds", {}).get("steps", ()):
        if step["value"] is None or value >= step["value"]:
            colour = step["color"]
    return NAMED[colour]


def _table(axes: Axes, panel: Any, lines: Sequence[Series], _: float) -> None:
    axes.axis("off")
    order = panel["transformations"][0]["options"]["indexByName"]
    columns = sorted(order, key=order.__getitem__)
    widths = {"name": 0.16, "version": 0.1, "variant": 0.14, "instance": 0.18}
    x = 0.0
    for column in columns:
        axes.text(x, 1.0, column, size=7.5, color=MUTED, va="top", transform=axes.transAxes)
        for index, line in enumerate(lines):
            said = line.labels.get(column, "")
            cut = said if len(said) <= 40 else said[:40] + "…"
            axes.text(
                x, 0.8 - 0.2 * index, cut, size=7.5, color=INK, va="top", transform=axes.transAxes
            )
        x += widths.get(column, 0.3)
