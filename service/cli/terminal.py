"""Tables for people: drawn on a terminal, plain aligned columns in a pipe."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from service.inference.results import AudioWarning

PIPE_WIDTH = 120  # columns where there is no terminal to ask

SECTORS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")


class Output(Console):
    """A console whose broken pipe is ``main``'s to answer; rich would exit with 1."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def output() -> Console:
    """Standard output as it is now; tests and pipes replace it."""
    console = Output(file=sys.stdout, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    return console


def table(console: Console, *columns: str, right: tuple[str, ...] = ()) -> Table:
    """An empty table whose columns named in ``right`` are aligned to the right."""
    drawn = Table(
        box=box.SIMPLE_HEAD if console.is_terminal else None,
        header_style="bold",
        pad_edge=False,
    )
    for column in columns:
        drawn.add_column(column, justify="right" if column in right else "left")
    return drawn


def line(console: Console, text: str, style: str | None = None) -> None:
    """Print text as it is: brackets are no markup."""
    console.print(escape(text), style=style, soft_wrap=True)


def warn(console: Console, warning: AudioWarning) -> None:
    """Print a warning about the input."""
    line(console, f"warning: {warning.code}: {warning.detail}", "yellow")


def sector(azimuth: float) -> str:
    """The direction in words of an azimuth in radians: 0 is the front, left comes next."""
    return SECTORS[round(azimuth / (math.pi / 4)) % len(SECTORS)]


def degrees(azimuth: float) -> str:
    """``45°`` of radians; 359.9 degrees are 0, not 360."""
    return f"{round(math.degrees(azimuth)) % 360}°"


def clock(seconds: float) -> str:
    """``0:03.5``, or ``1:02:03.5`` from an hour on."""
    tenths = round(seconds * 10)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    short = f"{minutes:02d}" if hours else f"{minutes}"
    return f"{f'{hours}:' if hours else ''}{short}:{rest / 10:04.1f}"
