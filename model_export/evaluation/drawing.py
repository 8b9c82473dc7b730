"""Style of the figures of evaluation and experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from model_export.baselines.catalogue import cards
from model_export.baselines.shipped import SHIPPED

OURS = "#d1495b"
INK = "#1f2937"
DPI = 130
DASHES = ("--", ":", "-.", (0, (5, 1)))


def axes(x: str, y: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    panel = figure.add_subplot()
    panel.set(xlabel=x, ylabel=y)
    panel.grid(alpha=0.25)
    panel.spines[["top", "right"]].set_visible(False)
    return figure, panel


def style(label: str) -> dict[str, Any]:
    """A method's line: ours red, classical ones grey and dashed, others in colours of their own."""
    name = label.split(",")[0]
    if name in SHIPPED:
        return {"color": INK, "lw": 2.0, "marker": "."}
    card = cards().get(name)
    if name == "neuralmusic":
        dashes = "--" if "," in label else "-"
        return {"color": OURS, "lw": 2.4, "marker": "o", "ls": dashes, "zorder": 3}
    place = list(cards()).index(name) if card else 0
    if card is not None and card.kind == "classical":
        return {"color": colormaps["Greys"](0.4 + 0.06 * place), "lw": 1.0, "ls": DASHES[place % 4]}
    return {"color": colormaps["tab10"]((place - 9) % 10), "lw": 1.4, "marker": "."}


def save(figure: Figure, folder: Path, name: str, dpi: int = DPI) -> str:
    """Write ``<name>.png``; returns the file's name."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=dpi)
    return f"{name}.png"
