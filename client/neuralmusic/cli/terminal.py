"""Tables for people with rich: drawn on a terminal, plain aligned columns in a pipe."""

from __future__ import annotations

import sys

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

PIPE_WIDTH = 120  # columns where there is no terminal to ask


class Output(Console):
    """A console that leaves a broken pipe to ``main``; rich would exit with 1."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def output() -> Console:
    """The present standard output, which tests and pipes replace."""
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
    """Print text as it is: brackets are not markup."""
    console.print(escape(text), style=style, soft_wrap=True)


def warn(console: Console, code: str, detail: str) -> None:
    """Print a warning about the input."""
    line(console, f"warning: {code}: {detail}", "yellow")
