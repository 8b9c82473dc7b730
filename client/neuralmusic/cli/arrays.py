"""``neuralmusic arrays``: the array presets, or one of them with its positions."""

from __future__ import annotations

import argparse

from neuralmusic.arrays import PRESETS, RAW_CHANNELS, ArrayPreset, preset
from neuralmusic.cli.words import columns

NAME = "arrays"
SUMMARY = "list the microphone array presets, or show one"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="show the positions of this preset")


def run(args: argparse.Namespace) -> int:
    print(_all() if args.name is None else _one(preset(args.name)))
    return 0


def _all() -> str:
    rows = [
        (array.name, str(len(array.positions_m)), f"{array.aperture_m * 1000:.0f} mm")
        for array in PRESETS.values()
    ]
    return columns([("name", "microphones", "across"), *rows], right=(1, 2))


def _one(array: ArrayPreset) -> str:
    rows = [
        (str(index), *(f"{value * 1000:.2f}" for value in position))
        for index, position in enumerate(array.positions_m)
    ]
    table = columns([("microphone", "x mm", "y mm", "z mm"), *rows], right=range(4))
    maps = [
        f"recordings of {count} channels: --channel-map {','.join(map(str, channels))}"
        for count, channels in RAW_CHANNELS.get(array.name, {}).items()
    ]
    return "\n".join([array.name, array.source, table, *maps])
