"""Microphone arrays and their channels as clients give them, read alike for every interface."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from neuralmusic.errors import ChannelMismatch, InvalidGeometry, InvalidOption
from neuralmusic.protocol.names import MAX_LABEL, is_label
from service.doa.array import MAX_MICROPHONES, MicrophoneArray, validate_channel_map
from service.doa.presets import preset, raw_channels
from service.inference.results import AudioWarning

FORM = '{"positions_m": [[x, y, z], ...]} in metres'


def read_array(text: str) -> MicrophoneArray:
    """A preset by its name, or the array of a JSON object.

    Raises
    ------
    UnknownArray, InvalidGeometry, InvalidOption
        As ``given_array``, and if the JSON is wrong.
    """
    if text[0] not in '{["':
        return preset(text)
    fields = _load(text)
    if not isinstance(fields, dict):
        raise InvalidOption(f"array must be a preset's name or a JSON object {FORM}")
    unknown = sorted(set(fields) - {"name", "positions_m"})
    if unknown:
        raise InvalidOption(
            f"array has no field {unknown[0][:MAX_LABEL]!r}: its fields are positions_m and name"
        )
    return given_array(fields.get("name"), fields.get("positions_m"))


def given_array(name: Any, positions: Any) -> MicrophoneArray:
    """The preset of a name, or an array of positions with that name; None means not given.

    Raises
    ------
    UnknownArray
        If no preset has that name.
    InvalidGeometry
        If the positions cannot be those of one array.
    InvalidOption
        If the name is invalid, or neither is given.
    """
    if name is not None and not is_label(name):
        raise InvalidOption(
            f"the array's name must be text of at most {MAX_LABEL} printable characters"
        )
    if positions is not None:
        return MicrophoneArray(name or "custom", _positions(positions), "the request")
    if name is None:
        raise InvalidOption(f"array holds neither a preset's name nor {FORM}")
    return preset(name)


def choose_channels(
    channels: int, array: MicrophoneArray | None, channel_map: Sequence[int] | None
) -> tuple[tuple[int, ...], list[AudioWarning]]:
    """One channel per microphone of audio with ``channels`` channels; all where no array is known.

    A given map wins. As many channels as microphones are taken as they are. Otherwise the known
    layout of a preset's firmware is assumed, with a warning.

    Raises
    ------
    InvalidChannelMap
        If the map does not name one distinct channel per microphone.
    ChannelMismatch
        If the audio's channels do not fit.
    """
    if channel_map is not None:
        chosen = validate_channel_map(
            channel_map, array.num_microphones if array else len(channel_map)
        )
        if max(chosen) >= channels:
            raise ChannelMismatch(
                f"channel_map names channel {max(chosen)}, but the audio has {channels} "
                f"channels, 0 to {channels - 1}"
            )
        return chosen, []
    if array is None or channels == array.num_microphones:
        return tuple(range(channels)), []
    raw = raw_channels(array, channels)
    if raw is None:
        raise _mismatch(channels, array)
    detail = (
        f"the audio has {channels} channels and no channel_map: the microphones were taken from "
        f"channels {', '.join(map(str, raw))}, as this device's firmware delivers them; pass "
        f"channel_map={','.join(map(str, raw))}, or the correct one"
    )
    return raw, [AudioWarning("channel_map_assumed", detail)]


def _mismatch(channels: int, array: MicrophoneArray) -> ChannelMismatch:
    microphones = array.num_microphones
    advice = (
        f"pass channel_map (--channel-map) with the {microphones} channels of the raw microphones"
        if channels > microphones
        else "record all microphones as separate channels, or choose the array that was used"
    )
    return ChannelMismatch(
        f"the audio has {channels} channel{'s' if channels != 1 else ''}, but the array "
        f"{array.name} has {microphones} microphones: {advice}"
    )


def _load(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidOption(
            f"array is not valid JSON ({error.msg} at character {error.pos}): send a preset's name "
            f"or {FORM}"
        ) from None
    except (ValueError, RecursionError):  # a number of thousands of digits, endless nesting
        raise InvalidOption(f"array is not usable JSON: send {FORM}") from None


def _positions(rows: Any) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Positions (N, 3) in metres."""
    if not isinstance(rows, list | tuple):
        raise InvalidGeometry(
            f"positions_m must be a list with one [x, y, z] per microphone: {FORM}"
        )
    for index, row in enumerate(rows[: MAX_MICROPHONES + 1]):
        if not isinstance(row, list | tuple) or not all(
            type(value) in (int, float) for value in row
        ):
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
