"""How sound is to be localized, as flags: the same for every command that does."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.inputs import Arguments, array_text

if TYPE_CHECKING:
    from service.recordings.options import LocalizeRequest

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
)
"""Of the flags that are options of the HTTP interface, besides the array"""


def add_choices(parser: Arguments) -> None:
    """``--method``, ``--model`` and the like, which recordings and streams share."""
    from service.protocol.methods import METHODS

    add = parser.add_argument
    add("--method", choices=METHODS, help="neural where a model fits the array")
    add("--model", metavar="NAME", help="the model bundle")
    add("--num-sources", metavar="M", help="the known number of sources")
    add("--max-sources", metavar="M", help="most sources, where it is estimated")
    add("--yaw", dest="yaw_deg", metavar="DEGREES", help="how far the array is turned on the robot")
    add(
        "--exclude",
        dest="exclude_deg",
        action="append",
        metavar="FROM:TO,...",
        help="sectors in degrees, counter-clockwise, in which nothing is reported; repeatable "
        "(--exclude=-30:30 around the front)",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """``add_choices``, ``--window`` and the like."""
    add_choices(parser)
    parser.add_argument(
        "--models", metavar="FOLDER", help="folders of further bundles, separated as in PATH"
    )
    parser.add_argument("--window", dest="window_s", metavar="SECONDS", help="audio per result")
    parser.add_argument("--hop", dest="hop_s", metavar="SECONDS", help="time between results")
    parser.add_argument(
        "--noise",
        type=Path,
        metavar="NPZ",
        help="a profile of the robot's own noise (neuralmusic noise), which is taken away",
    )


def given_options(args: argparse.Namespace) -> dict[str, str]:
    """The options that were given, by the HTTP interface's names and as its text."""
    flags = {name: getattr(args, name, None) for name in NAMES}
    given = {name: text for name, text in flags.items() if text is not None}
    if "exclude_deg" in given:
        given["exclude_deg"] = ",".join(given["exclude_deg"])
    return {"array": array_text(args.array), **given}


def read_request(args: argparse.Namespace, **more: str) -> LocalizeRequest:
    """The options, read and checked as those of a request, with the noise profile's content.

    Raises
    ------
    DoaError
        If one of them, or the noise profile, is wrong.
    OSError
        If a file that they name cannot be read.
    """
    from service.inference.noise_profile import load_noise
    from service.recordings.options import read_options

    asked = read_options([*given_options(args).items(), *more.items()])
    if args.noise is None:
        return asked
    return replace(asked, options=replace(asked.options, noise=load_noise(args.noise)))
