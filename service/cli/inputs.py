"""Arguments that commands share: the recording, its array and its channel map."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from service.errors import InvalidOption

if TYPE_CHECKING:
    from service.audio.recording import AudioLimits, Recording
    from service.doa.array import MicrophoneArray

MAX_SECONDS = 86_400.0  # the limits of the service protect others; this is the user's own machine
MAX_CHANNELS = 256


class Arguments(Protocol):
    """A parser, or a group of one."""

    @property
    def add_argument(self) -> Callable[..., argparse.Action]: ...


def add_recording(parser: argparse.ArgumentParser) -> None:
    """The positional FILE and ``--channel-map``."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a multichannel WAV or FLAC file")
    add_channel_map(parser)


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
        help="the service's key; safer from other users of this machine: @FILE that holds it, or "
        "the variable NEURALMUSIC_KEY",
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


def generous_limits() -> AudioLimits:
    """What a recording of the user's own may claim."""
    from service.audio.recording import AudioLimits

    return AudioLimits(max_channels=MAX_CHANNELS, max_seconds=MAX_SECONDS)


def open_recording(path: Path) -> Recording:
    """Open a file with generous limits."""
    from service.audio.recording import Recording

    return Recording.open(path, generous_limits())


def array_text(argument: str) -> str:
    """The array as the HTTP interface takes it; ``@geometry.json`` is the file's content."""
    if not argument.startswith("@"):
        return argument
    try:
        return Path(argument[1:]).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InvalidOption(f"{argument[1:]} is no text file: give JSON with positions_m") from None


def read_array(argument: str) -> MicrophoneArray:
    """The array of ``--array``: a preset's name, JSON or ``@file.json``."""
    from service.recordings.options import read_option

    array: MicrophoneArray = read_option("array", array_text(argument))
    return array


def read_channel_map(argument: str | None) -> tuple[int, ...] | None:
    """The channels of ``--channel-map``, if it was given."""
    from service.recordings.options import read_option

    return None if argument is None else read_option("channel_map", argument)
