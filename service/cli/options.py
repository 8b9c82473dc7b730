"""Flags for the options of localization, the same for every command that localizes."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuralmusic.cli.flags import add_choices, given_options

if TYPE_CHECKING:
    from service.recordings.options import LocalizeRequest


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add ``add_choices``, ``--window`` and further flags."""
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
        help="a profile of the robot's own noise (neuralmusic noise), to be removed",
    )


def read_request(args: argparse.Namespace, **more: str) -> LocalizeRequest:
    """The options, read and checked like a request's, with the noise profile's content.

    Raises
    ------
    DoaError
        If an option or the noise profile is wrong.
    OSError
        If a named file cannot be read.
    """
    from service.inference.noise_profile import load_noise
    from service.recordings.options import read_options

    asked = read_options([*given_options(args).items(), *more.items()])
    if args.noise is None:
        return asked
    return replace(asked, options=replace(asked.options, noise=load_noise(args.noise)))
