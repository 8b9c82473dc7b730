"""Microphone arrays and channel maps as clients write them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from service.doa.array import MAX_MICROPHONES, MicrophoneArray
from service.doa.presets import preset
from service.errors import InvalidGeometry, InvalidOption

MAX_NAME = 64
FORM = '{"positions_m": [[x, y, z], ...]} in metres'


def read_array(text: str) -> MicrophoneArray:
    """A preset by its name, or the array of a JSON object.

    Raises
    ------
    UnknownArray
        If no preset has that name.
    InvalidGeometry
        If the positions cannot be those of one array.
    InvalidOption
        If the JSON is wrong.
    """
    if text[0] not in '{["':
        return preset(text)
    fields = _load(text)
    if not isinstance(fields, dict):
        raise InvalidOption(f"array must be a preset's name or a JSON object {FORM}")
    unknown = sorted(set(fields) - {"name", "positions_m"})
    if unknown:
        raise InvalidOption(
            f"array has no field {unknown[0][:MAX_NAME]!r}: its fields are positions_m and name"
        )
    name = fields.get("name", "custom")
    # Not printable are surrogates, too, which JSON can spell and UTF-8 cannot.
    if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME or not name.isprintable():
        raise InvalidOption(
            f"the array's name must be text of at most {MAX_NAME} printable characters"
        )
    if "positions_m" in fields:
        return MicrophoneArray(name, _positions(fields["positions_m"]), "the request")
    if "name" in fields:
        return preset(name)
    raise InvalidOption(f"array holds neither a preset's name nor {FORM}")


def read_channel_map(text: str) -> tuple[int, ...]:
    """Channels as a JSON list or separated by commas; raises ValueError."""
    sentence = "must list one whole number per microphone, as 1,2,3,4 or [1,2,3,4]"
    try:
        channels = json.loads(text if text.startswith("[") else f"[{text}]")
    except (ValueError, RecursionError):
        raise ValueError(sentence) from None
    if not all(type(channel) is int for channel in channels):
        raise ValueError(sentence)
    return tuple(channels)


def _load(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidOption(
            f"array is no valid JSON ({error.msg} at character {error.pos}): send a preset's name "
            f"or {FORM}"
        ) from None
    except (ValueError, RecursionError):  # a number of thousands of digits, endless nesting
        raise InvalidOption(f"array is no usable JSON: send {FORM}") from None


def _positions(rows: Any) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Positions (N, 3) in metres."""
    if not isinstance(rows, list):
        raise InvalidGeometry(
            f"positions_m must be a list with one [x, y, z] per microphone: {FORM}"
        )
    for index, row in enumerate(rows[: MAX_MICROPHONES + 1]):
        if not isinstance(row, list) or not all(type(value) in (int, float) for value in row):
            raise InvalidGeometry(f"microphone {index} is not a list of three numbers: {FORM}")
        if len(row) != 3:
            level = ", with z = 0 for a level array" if len(row) == 2 else ""
            raise InvalidGeometry(
                f"microphone {index} has {len(row)} coordinates: give [x, y, z] in metres{level}"
            )
    if len(rows) > MAX_MICROPHONES:
        raise InvalidGeometry(
            f"an array has at most {MAX_MICROPHONES} microphones, but {len(rows)} positions were "
            "given"
        )
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)
    except OverflowError:
        raise InvalidGeometry("microphone positions must be finite numbers") from None
