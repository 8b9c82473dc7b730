"""Flags that commands share: the array and its channels, how to localize, the service's key."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.methods import HEMISPHERES, METHODS

NAMES = (
    "channel_map",
    "method",
    "model",
    "num_sources",
    "max_sources",
    "window_s",
    "hop_s",
    "yaw_deg",
    "exclude_deg",
    "hemisphere",
)
"""Flags that are options of the HTTP interface, besides the array"""


class Arguments(Protocol):
    """A parser, or a group of one."""

    @property
    def add_argument(self) -> Callable[..., argparse.Action]: ...


def add_channel_map(parser: Arguments) -> None:
    """``--channel-map``."""
    parser.add_argument(
        "--channel-map",
        metavar="0,1,...",
        help="the channel of every microphone, from 0, where there are more channels",
    )


def add_array(parser: Arguments, *, required: bool = True, help: str = "") -> None:
    """``--array``."""
    parser.add_argument(
        "--array",
        required=required,
        metavar="NAME|JSON|@FILE",
        help="the microphone array: a preset (neuralmusic arrays), or JSON with positions_m" + help,
    )


def add_key(parser: Arguments) -> None:
    """``--key``, for commands that ask a running service."""
    parser.add_argument(
        "--key",
        metavar="KEY|@FILE",
        help="the service's key; other users of this machine do not see it as @FILE or in the "
        "variable NEURALMUSIC_KEY",
    )


def given_key(argument: str | None) -> str | None:
    """The key of ``--key``, else of the environment, else None."""
    if argument is None:
        return os.environ.get("NEURALMUSIC_KEY") or None
    if not argument.startswith("@"):
        return argument
    try:
        return Path(argument[1:]).read_text(encoding="ascii").strip()
    except UnicodeDecodeError:
        raise InvalidOption(f"{argument[1:]} holds no key") from None


def add_choices(parser: Arguments) -> None:
    """``--method``, ``--model`` and further flags that recordings and streams share."""
    add = parser.add_argument
    add("--method", choices=METHODS, help="neural where a model fits the array")
    add("--model", metavar="NAME", help="the model; the default is the best that fits the array")
    add("--num-sources", metavar="M", help="the known number of sources")
    add("--max-sources", metavar="M", help="most sources, where their number is estimated")
    add("--yaw", dest="yaw_deg", metavar="DEGREES", help="how far the array is turned on the robot")
    add(
        "--hemisphere",
        choices=HEMISPHERES,
        help="the side of the horizontal plane on which sources are: a level array then tells "
        "their elevation",
    )
    add(
        "--exclude",
        dest="exclude_deg",
        action="append",
        metavar="FROM:TO,...",
        help="sectors in degrees, counter-clockwise, in which nothing is reported; repeatable "
        "(--exclude=-30:30 around the front)",
    )


def array_text(argument: str) -> str:
    """The array as the HTTP interface takes it; ``@geometry.json`` is the file's content."""
    if not argument.startswith("@"):
        return argument
    try:
        return Path(argument[1:]).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InvalidOption(f"{argument[1:]} is no text file: give JSON with positions_m") from None


def given_options(args: argparse.Namespace) -> dict[str, str]:
    """The given options, with the names and texts of the HTTP interface."""
    flags = {name: getattr(args, name, None) for name in NAMES}
    given = {name: text for name, text in flags.items() if text is not None}
    if "exclude_deg" in given:
        given["exclude_deg"] = ",".join(given["exclude_deg"])
    return {"array": array_text(args.array), **given}
