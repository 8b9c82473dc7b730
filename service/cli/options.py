"""How recordings are to be localized, as flags: the same for every command that does."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.inputs import array_text

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


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--method``, ``--model``, ``--window`` and the like."""
    from service.protocol.methods import METHODS

    parser.add_argument("--method", choices=METHODS, help="neural where a model fits the array")
    parser.add_argument("--model", metavar="NAME", help="the model bundle")
    parser.add_argument(
        "--models", metavar="FOLDER", help="folders of further bundles, separated as in PATH"
    )
    parser.add_argument("--num-sources", metavar="M", help="the known number of sources")
    parser.add_argument("--max-sources", metavar="M", help="most sources, where it is estimated")
    parser.add_argument("--window", dest="window_s", metavar="SECONDS", help="audio per result")
    parser.add_argument("--hop", dest="hop_s", metavar="SECONDS", help="time between results")
    parser.add_argument(
        "--yaw", dest="yaw_deg", metavar="DEGREES", help="how far the array is turned on the robot"
    )
    parser.add_argument(
        "--exclude",
        dest="exclude_deg",
        metavar="FROM:TO,...",
        help="sectors in degrees in which nothing is reported (--exclude=-30:30 around the front)",
    )
    parser.add_argument(
        "--noise",
        type=Path,
        metavar="NPZ",
        help="a profile of the robot's own noise (neuralmusic noise), which is taken away",
    )


def given_options(args: argparse.Namespace) -> dict[str, str]:
    """The options that were given, by the HTTP interface's names and as its text."""
    flags = {name: getattr(args, name) for name in NAMES}
    given = {name: text for name, text in flags.items() if text is not None}
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
