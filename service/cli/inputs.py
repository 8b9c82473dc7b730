"""The recording of a command, its array and its channel map."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, BinaryIO, cast

from neuralmusic.cli.flags import add_channel_map, array_text

if TYPE_CHECKING:
    from service.audio.recording import AudioLimits, Recording
    from service.doa.array import MicrophoneArray

STDIN = Path("-")
MAX_SECONDS = 86_400.0  # the service's limits protect other clients; this machine is the user's own
MAX_CHANNELS = 256


def add_recording(parser: argparse.ArgumentParser) -> None:
    """The positional FILE and ``--channel-map``."""
    words = "a multichannel WAV or FLAC file; - is standard input"
    parser.add_argument("file", type=Path, metavar="FILE", help=words)
    add_channel_map(parser)


def generous_limits() -> AudioLimits:
    """Limits for a recording of the user's own."""
    from service.audio.recording import AudioLimits

    return AudioLimits(max_channels=MAX_CHANNELS, max_seconds=MAX_SECONDS)


def open_recording(path: Path) -> Recording:
    """Open a file, or standard input's copy on disk for ``-``, with generous limits."""
    from service.audio.recording import Recording

    return Recording.open(_standard_input() if path == STDIN else path, generous_limits())


def _standard_input() -> BinaryIO:
    """All of standard input in a temporary file, as readers seek; it vanishes when closed."""
    file = cast("BinaryIO", TemporaryFile())  # noqa: SIM115 - it lives as long as the recording
    shutil.copyfileobj(sys.stdin.buffer, file)
    return file


def read_array(argument: str) -> MicrophoneArray:
    """The array of ``--array``: a preset's name, JSON or ``@file.json``."""
    from service.recordings.options import read_option

    array: MicrophoneArray = read_option("array", array_text(argument))
    return array


def read_channel_map(argument: str | None) -> tuple[int, ...] | None:
    """The channels of ``--channel-map``, if it was given."""
    from service.recordings.options import read_option

    return None if argument is None else read_option("channel_map", argument)
