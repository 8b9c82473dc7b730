"""The options of ``POST /localize``: one table reads them and documents them.

Options arrive as text, in the query or in form fields, and become ``LocalizeOptions``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from typing import Any

from neuralmusic.errors import InvalidOption, TooManySources, UnknownMethod
from neuralmusic.option_text import (
    SPHERE,
    read_angle,
    read_channel_map,
    read_integer,
    read_number,
    read_sectors,
    read_spectrum,
    read_text,
)
from neuralmusic.protocol.message import SHOWN
from neuralmusic.protocol.methods import HEMISPHERES, METHODS
from service.doa.array import MicrophoneArray, validate_channel_map
from service.doa.orientation import Orientation
from service.doa.presets import PRESETS
from service.inference.geometry import read_array
from service.inference.results import MAX_SOURCES
from service.recordings.results import (
    DEFAULT_HOP_S,
    DEFAULT_MAX_SOURCES,
    DEFAULT_WINDOW_S,
    SHORTEST_WINDOW_S,
    LocalizeOptions,
)


@dataclass(frozen=True, slots=True)
class LocalizeRequest:
    """What a request asks for, beside its recording."""

    options: LocalizeOptions
    noise: str | None = None
    """Name of the stored profile of the robot's own noise"""


@dataclass(frozen=True, slots=True)
class Option:
    """How one option is read and documented."""

    read: Callable[[str], Any]
    """Reads the text; a ValueError completes a sentence that begins with the option's name"""
    schema: Mapping[str, Any]
    description: str
    example: str | None = None


def number(low: float, high: float, default: float, description: str) -> Option:
    """A real number within bounds."""
    bounds = {"type": "number", "minimum": low, "maximum": high, "default": default}
    return Option(partial(read_number, low=low, high=high), bounds, description)


def integer(low: int, high: int, default: int | None, description: str) -> Option:
    """A whole number of at least ``low``; the caller checks ``high``."""
    bounds = {"type": "integer", "minimum": low, "maximum": high}
    if default is not None:
        bounds["default"] = default
    return Option(partial(read_integer, low=low, high=high), bounds, description)


OPTIONS: Mapping[str, Option] = {
    "array": Option(
        read_array,
        {"type": "string"},
        "Required: a preset's name (`GET /arrays` lists them), or JSON with `positions_m`, one "
        "`[x, y, z]` in metres per microphone (x forward, y left, z up), and an optional `name`.",
        example="respeaker-usb-4mic-v2",
    ),
    "channel_map": Option(
        read_channel_map,
        {"type": "string"},
        "The recording's channel of every microphone, from 0, as `1,2,3,4` or a JSON list. "
        "Without it a recording with one channel per microphone is taken as it is. One with the "
        "channels of the preset's firmware is mapped by `raw_channels` of `GET /arrays`, with the "
        "warning `channel_map_assumed`.",
        example="1,2,3,4",
    ),
    "model": Option(
        str,
        {"type": "string"},
        "A model's name (`GET /models` lists them, the best first). The default is the first that "
        "fits the array.",
    ),
    "method": Option(
        str,
        {"type": "string", "enum": list(METHODS)},
        "The default is `neural` where a model fits the array, else `norm_music`.",
    ),
    "num_sources": integer(
        1,
        MAX_SOURCES,
        None,
        "The known number of sources, those in excluded sectors included, below the number of "
        "microphones. It overrides `max_sources`; without it the number is estimated for every "
        "window.",
    ),
    "max_sources": integer(
        1, MAX_SOURCES, DEFAULT_MAX_SOURCES, "Most sources where the number is estimated."
    ),
    "window_s": number(SHORTEST_WINDOW_S, 10, DEFAULT_WINDOW_S, "Seconds of audio per result."),
    "hop_s": number(0.02, 10, DEFAULT_HOP_S, "Seconds from one result to the next."),
    "yaw_deg": Option(
        read_angle,
        {"type": "number", "default": 0.0},
        "Degrees by which the array is turned counter-clockwise on the robot, any finite angle; "
        "azimuths include it.",
    ),
    "exclude_deg": Option(
        read_sectors,
        {"type": "string"},
        "Sectors in which nothing is reported, as `from:to` in degrees, counter-clockwise, after "
        "the yaw offset, separated by commas.",
        example="80:100,350:10",
    ),
    "hemisphere": Option(
        str,
        {"type": "string", "enum": list(HEMISPHERES), "default": "both"},
        "Side of the horizontal plane on which all sources are. A level array tells elevations "
        "only where it is known.",
    ),
    "noise": Option(
        str,
        {"type": "string"},
        "Name of a profile of the robot's own noise, to be removed (`GET /noise` lists them, "
        "`PUT /noise/{name}` stores one).",
    ),
    "spectrum": Option(
        read_spectrum,
        {
            "oneOf": [{"type": "boolean"}, {"type": "string", "enum": [SPHERE]}],
            "default": False,
        },
        "Whether every window in the answer has its spatial spectrum, 360 values. With `sphere` it "
        "has an image of the sphere instead, `sphere`: 36 rows of 72 values, where the array "
        "tells elevations.",
    ),
}


def read_options(pairs: Iterable[tuple[str, str]]) -> LocalizeRequest:
    """Read options from name and text pairs.

    Raises
    ------
    InvalidOption
        If an option is unknown, given twice, unreadable or out of range.
    ArrayError, UnknownMethod, TooManySources
        If an option is readable but names nothing known.
    """
    values: dict[str, Any] = {}
    for name, text in pairs:
        if name in values:
            raise InvalidOption(f"{name} was given twice: give it once")
        values[name] = read_option(name, text)
    if "array" not in values:
        raise InvalidOption(
            "array is missing: name the microphone array, one of "
            f"{', '.join(PRESETS)}, or send its geometry as JSON with positions_m"
        )
    noise = values.pop("noise", None)
    values["orientation"] = Orientation.of_degrees(
        values.pop("yaw_deg", 0.0), values.pop("exclude_deg", ())
    )
    if values.get("spectrum") == SPHERE:
        values.update(spectrum=False, sphere=True)
    _check(values)
    return LocalizeRequest(LocalizeOptions(**values), noise)


def read_option(name: str, text: str) -> Any:
    """The value of one option from its text, or InvalidOption."""
    option = OPTIONS.get(name)
    if option is None:
        close = get_close_matches(name, OPTIONS, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise InvalidOption(
            f"there is no option {name[:SHOWN]!r}: {hint}the options are {', '.join(OPTIONS)}"
        )
    return read_text(name, text, option.read)


def _check(values: dict[str, Any]) -> None:
    """Check bounds that depend on other options or have an error of their own."""
    array: MicrophoneArray = values["array"]
    if "channel_map" in values:
        validate_channel_map(values["channel_map"], array.num_microphones)
    method = values.get("method")
    if method is not None and method not in METHODS:
        raise UnknownMethod(
            f"no method is called {method[:SHOWN]!r}: the methods are {', '.join(METHODS)}"
        )
    if values.get("hemisphere", "both") not in HEMISPHERES:
        raise InvalidOption(f"hemisphere must be one of {', '.join(HEMISPHERES)}")
    most = min(MAX_SOURCES, array.num_microphones - 1)
    if values.get("num_sources", 1) > most:
        raise TooManySources(
            f"num_sources is {values['num_sources']}, but at most {most} are told apart with "
            f"{array.num_microphones} microphones: ask for fewer, or leave num_sources out"
        )
    if values.get("max_sources", 1) > MAX_SOURCES:
        raise InvalidOption(f"max_sources must be at most {MAX_SOURCES}")
