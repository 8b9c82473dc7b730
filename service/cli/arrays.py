"""``neuralmusic arrays``: the array presets, or one of them with its positions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from service.cli.terminal import line, output, table

if TYPE_CHECKING:
    from rich.console import Console

    from service.doa.array import MicrophoneArray

NAME = "arrays"
SUMMARY = "list the microphone array presets, or show one"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="show the positions of this preset")


def run(args: argparse.Namespace) -> int:
    from service.doa.presets import PRESETS, preset

    console = output()
    if args.name is None:
        _print_all(console, tuple(PRESETS.values()))
    else:
        _print_one(console, preset(args.name))
    return 0


def _print_all(console: Console, arrays: tuple[MicrophoneArray, ...]) -> None:
    drawn = table(console, "name", "microphones", "across", right=("microphones", "across"))
    for array in arrays:
        drawn.add_row(array.name, str(array.num_microphones), f"{array.aperture * 1000:.0f} mm")
    console.print(drawn)


def _print_one(console: Console, array: MicrophoneArray) -> None:
    from service.doa.presets import RAW_CHANNELS

    line(console, array.name, "bold")
    line(console, array.source)
    columns = ("microphone", "x mm", "y mm", "z mm")
    drawn = table(console, *columns, right=columns)
    for index, position in enumerate(array.positions * 1000):
        drawn.add_row(str(index), *(f"{value:.2f}" for value in position))
    console.print(drawn)
    for count, channels in RAW_CHANNELS.get(array.name, {}).items():
        mapped = ",".join(map(str, channels))
        line(console, f"recordings of {count} channels: --channel-map {mapped}")
