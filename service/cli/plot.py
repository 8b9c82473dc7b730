"""The picture of a localized recording: array, spectrum and directions, and azimuth over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neuralmusic.errors import ConfigError
from service.doa.array import pairwise_distances
from service.doa.types import FloatArray
from service.recordings.results import RecordingResult, SummarySource

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

INK = "#1f2933"
LABEL = "#616e7c"
FAINT = "#9aa5b1"
FILL = "#4c9f9b"
NEEDLE = "#d1495b"
MAP = "GnBu"
SIZE = (12.0, 5.6)  # inches
RESOLUTION = 150  # dots per inch
ARRAY_RADIUS = 0.34  # radius, in the polar view, of the disc that shows the array
NAMED = {0: "front\n0°", 90: "left\n90°", 180: "180°\nback", 270: "right\n270°"}
LABEL_RADIUS = 0.78
PASSES = 200  # passes that push overlapping labels apart, each by half of the overlap
MANY_WINDOWS = 100  # windows above which the dots are smaller
MIN_GAP = math.radians(19.0)  # gap between the labels of two directions


def check_drawable(path: Path) -> None:
    """Raise ConfigError where a picture cannot be drawn into this file.

    matplotlib is an optional extra, and the suffix names the format.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
    except ImportError:
        raise ConfigError(
            "pictures need matplotlib: pip install ./client '.[plot]' in the project's folder, or "
            "leave --plot out"
        ) from None
    if path.suffix[1:].lower() not in FigureCanvasAgg.get_supported_filetypes():
        raise ConfigError(f"{path} names no picture format: end it in .png, .svg or .pdf")


def save_figure(result: RecordingResult, path: Path) -> None:
    """Draw a result into a file; raises ConfigError where ``check_drawable`` does."""
    check_drawable(path)
    localization_figure(result).savefig(path, dpi=RESOLUTION)


def localization_figure(result: RecordingResult) -> Figure:
    """A figure: on the left the mean spectrum around the array, on the right azimuth over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, facecolor="white")  # no pyplot: no global state, no window
    FigureCanvasAgg(figure)
    polar: Any = figure.add_axes((0.045, 0.09, 0.36, 0.74), projection="polar")
    timeline = figure.add_axes((0.49, 0.12, 0.435, 0.71))
    colours = figure.add_axes((0.937, 0.12, 0.011, 0.71))
    _title(figure, result)
    _draw_polar(polar, result)
    _draw_array(polar, result)
    _draw_timeline(timeline, colours, result)
    return figure


def mean_spectrum(result: RecordingResult) -> FloatArray:
    """Mean spectrum of the windows with sources, or of all if none has any, scaled to maximum 1."""
    heard = [window for window in result.windows if window.estimate.sources]
    spectra = [window.estimate.spectrum for window in heard or result.windows]
    mean: FloatArray = np.mean(spectra, axis=0) if spectra else np.zeros(360)
    peak = float(mean.max())
    return mean / peak if peak > 0 else mean


def spread_labels(azimuths: Sequence[float], gap: float = MIN_GAP) -> list[float]:
    """Azimuths in radians, moved apart until neighbours keep the gap, in the given order."""
    count = len(azimuths)
    if count < 2:
        return list(azimuths)
    order = np.argsort(azimuths)
    around = np.asarray(azimuths, dtype=np.float64)[order]
    # Cut the circle at its widest gap, so that the labels lie on a line and push along it.
    first = int(np.argmax(np.diff(around, append=around[0] + 2 * math.pi))) + 1
    order = np.roll(order, -first)
    line = np.concatenate([around[first:], around[:first] + 2 * math.pi])
    gap = min(gap, 2 * math.pi / count)
    for _ in range(PASSES):
        overlap = np.maximum(gap - np.diff(line), 0.0) / 2
        line[:-1] -= overlap / 2
        line[1:] += overlap / 2
    spread = np.empty(count)
    spread[order] = line
    return [float(azimuth % (2 * math.pi)) for azimuth in spread]


def _title(figure: Figure, result: RecordingResult) -> None:
    by = f"{result.model.name} {result.model.version}" if result.model else result.method
    array = result.array
    figure.text(0.03, 0.93, "Directions of arrival", fontsize=16, color=INK, weight="bold")
    figure.text(
        0.97,
        0.93,
        f"{array.name}, {array.aperture * 1000:.0f} mm across  ·  {by}  ·  {result.duration:.1f} s",
        fontsize=10,
        color=LABEL,
        ha="right",
    )
    figure.text(
        0.49,
        0.85,
        "colour: spatial spectrum  ·  dots: sources, larger with confidence",
        fontsize=9,
        color=LABEL,
    )


def _draw_polar(axes: PolarAxes, result: RecordingResult) -> None:
    axes.set_theta_zero_location("N")  # 0 degrees, the front, points up; left is left
    axes.set_ylim(0, 1.0)
    axes.set_yticks([])
    axes.set_xticks(np.deg2rad(np.arange(0, 360, 30)))
    axes.set_xticklabels(
        [NAMED.get(degrees, f"{degrees}°") for degrees in range(0, 360, 30)],
        fontsize=9,
        color=LABEL,
    )
    axes.tick_params(pad=6)
    axes.grid(color=FAINT, alpha=0.25, linewidth=0.6)
    axes.spines["polar"].set_color(FAINT)
    spectrum = mean_spectrum(result)
    angle = np.linspace(0, 2 * np.pi, spectrum.size + 1)
    height = ARRAY_RADIUS + (0.96 - ARRAY_RADIUS) * np.append(spectrum, spectrum[0])
    base = np.full_like(height, ARRAY_RADIUS)
    axes.fill_between(angle, base, height, color=FILL, alpha=0.35, linewidth=0)
    axes.plot(angle, height, color=FILL, linewidth=1.4)
    _draw_needles(axes, result.summary)


def _draw_needles(axes: PolarAxes, sources: Sequence[SummarySource]) -> None:
    places = spread_labels([source.azimuth for source in sources])
    for source, place in zip(sources, places, strict=True):
        axes.plot(
            [source.azimuth, source.azimuth],
            [ARRAY_RADIUS, 1.0],
            color=NEEDLE,
            linewidth=1.2 + 2.0 * source.share,
            solid_capstyle="round",
            zorder=4,
        )
        axes.text(
            place,
            LABEL_RADIUS,
            f"{math.degrees(source.azimuth) % 360:.0f}°",
            color="white",
            fontsize=11,
            weight="bold",
            ha="center",
            va="center",
            zorder=6,
            bbox={"boxstyle": "round,pad=0.3", "facecolor": NEEDLE, "edgecolor": "none"},
        )


def _draw_array(axes: PolarAxes, result: RecordingResult) -> None:
    """Draw the microphones to scale on a disc in the middle, x up and y to the left."""
    centred = result.array.positions - result.array.positions.mean(axis=0)
    radius = np.hypot(centred[:, 0], centred[:, 1])
    scale = 0.6 * ARRAY_RADIUS / max(float(radius.max()), 1e-9)
    angle = np.linspace(0, 2 * np.pi, 181)
    axes.fill_between(angle, 0, np.full_like(angle, ARRAY_RADIUS), color="#f5f7fa", zorder=3)
    axes.plot(angle, np.full_like(angle, ARRAY_RADIUS), color=FAINT, linewidth=0.8, zorder=3)
    azimuth = np.arctan2(centred[:, 1], centred[:, 0])
    crowded = pairwise_distances(centred)[~np.eye(len(centred), dtype=bool)].min() * scale
    axes.scatter(azimuth, radius * scale, s=26 if crowded > 0.1 else 10, color=INK, zorder=5)
    if crowded < 0.1:  # their numbers would cover each other
        return
    for index, (theta, distance) in enumerate(zip(azimuth, radius, strict=True)):
        place = distance * scale + 0.21 * ARRAY_RADIUS
        channel = str(result.channel_map[index])
        axes.text(theta, place, channel, fontsize=8, color=INK, ha="center", va="center", zorder=5)


def _draw_timeline(axes: Axes, colours: Axes, result: RecordingResult) -> None:
    edges = [window.t_start for window in result.windows]
    end = max(result.duration, 1e-3)
    if result.windows:
        image = np.stack([window.estimate.spectrum for window in result.windows], axis=-1)
        step = 360 / image.shape[0]
        rows = np.arange(image.shape[0] + 1) * step - step / 2
        mesh = axes.pcolormesh(
            np.append(edges, end), rows, image, cmap=MAP, vmin=0, vmax=1, rasterized=True
        )
        bar = axes.figure.colorbar(mesh, cax=colours)
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=8, colors=LABEL, length=2)
        bar.set_ticks([0, 0.5, 1])
    _draw_dots(axes, result, [*edges, end])
    axes.set_xlim(0, end)
    axes.set_ylim(0, 360)
    axes.set_yticks(range(0, 361, 45))
    axes.set_xlabel("time in seconds", color=INK, fontsize=10)
    axes.set_ylabel("azimuth in degrees", color=INK, fontsize=10)
    axes.tick_params(labelsize=9, colors=INK)
    for spine in axes.spines.values():
        spine.set_color(FAINT)


def _draw_dots(axes: Axes, result: RecordingResult, edges: Sequence[float]) -> None:
    """Draw every window's sources in the middle of its column, larger with confidence."""
    dots = [
        ((edges[index] + edges[index + 1]) / 2, math.degrees(source.azimuth), source.confidence)
        for index, window in enumerate(result.windows)
        for source in window.estimate.sources
    ]
    if not dots:
        return
    time, azimuth, confidence = np.array(dots).T
    shrink = min(1.0, MANY_WINDOWS / len(result.windows))
    axes.scatter(
        time,
        azimuth,
        s=shrink * (8 + 42 * confidence**2),
        color=NEEDLE,
        edgecolor="white",
        linewidth=0.6 * shrink,
        zorder=4,
        clip_on=False,
    )
