"""Arguments that commands share: the recording, its array and its channel map."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from service.errors import ChannelMismatch, InvalidOption

if TYPE_CHECKING:
    from service.audio.recording import AudioLimits, Recording
    from service.doa.array import MicrophoneArray

MAX_SECONDS = 86_400.0  # the limits of the service protect others; this is the user's own machine
MAX_CHANNELS = 256


class Arguments(Protocol):
    """A parser, or a group of one."""

    @property
    def add_argument(self) -> Callable[..., argparse.Action]: ...


class Channels(Protocol):
    """Anything with channels: a recording or an audio device."""

    @property
    def channels(self) -> int: ...


def add_recording(parser: argparse.ArgumentParser) -> None:
    """The positional FILE and ``--channel-map``."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a multichannel WAV or FLAC file")
    add_channel_map(parser)


def add_channel_map(parser: argparse.ArgumentParser) -> None:
    """``--channel-map``."""
    parser.add_argument(
        "--channel-map",
        metavar="0,1,...",
        help="the file's channel of every microphone, from 0, where the file has more channels",
    )


def add_array(parser: argparse.ArgumentParser) -> None:
    """The required ``--array``."""
    parser.add_argument(
        "--array",
        required=True,
        metavar="NAME|JSON|@FILE",
        help="the microphone array: a preset (neuralmusic arrays), or JSON with positions_m",
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
    from service.recordings import geometry

    text = array_text(argument).strip()
    if not text:
        raise InvalidOption("array is empty: give a preset's name, JSON or @file.json")
    return geometry.read_array(text)


def choose_channels(
    source: Channels, array: MicrophoneArray | None, channel_map: str | None, what: str = "file"
) -> tuple[int, ...]:
    """The channels of a file, or of ``what`` it is, that are microphones.

    They are those of ``--channel-map``, or all, or what the preset's firmware is known to deliver.

    Raises
    ------
    ChannelMismatch
        If its channels do not fit the array or the map.
    """
    from service.doa.array import validate_channel_map
    from service.doa.presets import RAW_CHANNELS
    from service.recordings.geometry import read_channel_map

    if channel_map is not None:
        try:
            chosen = read_channel_map(channel_map)
        except ValueError as error:
            raise InvalidOption(f"channel_map {error}") from None
        validate_channel_map(chosen, array.num_microphones if array else len(chosen))
        if max(chosen) >= source.channels:
            raise ChannelMismatch(
                f"channel_map names channel {max(chosen)}, but the {what} has {source.channels} "
                f"channels, 0 to {source.channels - 1}"
            )
        return chosen
    if array is None or array.num_microphones == source.channels:
        return tuple(range(source.channels))
    raw = RAW_CHANNELS.get(array.name, {}).get(source.channels)
    if raw is None:
        advice = (
            "name their channels with --channel-map"
            if source.channels > array.num_microphones
            else "record all microphones as separate channels, or choose the array that was used"
        )
        raise ChannelMismatch(
            f"the {what} has {source.channels} channel{'s' if source.channels != 1 else ''}, but "
            f"{array.name} has {array.num_microphones} microphones: {advice}"
        )
    return raw
