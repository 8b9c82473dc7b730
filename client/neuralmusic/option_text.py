"""Options as text: query parameters, form fields and flags are read by the same functions.

Readers raise ValueError; its text completes a sentence that begins with the option's name.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import TypeVar, Union

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.message import SHOWN

T = TypeVar("T")
NUMBER = re.compile(r"-?(\d+(\.\d+)?(e-?\d+)?|\.\d+(e-?\d+)?|\d+\.)", re.ASCII | re.IGNORECASE)
"""Numbers that clients may write; float() would also take "nan", "1_0" and digits of any script.
No part may match in two ways: 64,000 digits and a letter would take minutes"""
MAX_DIGITS = 64
"""Most characters of a number"""
MAX_SECTORS = 16
"""Most excluded sectors, as for a stream"""
SPHERE = "sphere"
"""Value of ``spectrum`` that asks for images of the sphere"""


def read_text(name: str, text: str, read: Callable[[str], T]) -> T:
    """The value of an option from its text, or InvalidOption."""
    text = text.strip()
    if not text:
        raise InvalidOption(f"{name} is empty: give a value or leave it out")
    try:
        return read(text)
    except ValueError as error:
        shown = text if len(text) <= SHOWN else text[:SHOWN] + "..."
        raise InvalidOption(f"{name} {error}, but is {json.dumps(shown)}") from None


def read_number(text: str, low: float, high: float) -> float:
    """A real number within bounds."""
    if len(text) > MAX_DIGITS or not NUMBER.fullmatch(text):
        raise ValueError(f"must be a number from {low:g} to {high:g}")
    value = float(text)
    if not low <= value <= high:
        raise ValueError(f"must be from {low:g} to {high:g}")
    return value


def read_angle(text: str) -> float:
    """An angle in degrees, of as many turns as it likes."""
    value = float(text) if len(text) <= MAX_DIGITS and NUMBER.fullmatch(text) else math.inf
    if math.isinf(value):
        raise ValueError("must be an angle in degrees, such as -90 or 450")
    return value


def read_integer(text: str, low: int, high: int) -> int:
    """A whole number of at least ``low``; the caller checks ``high``."""
    if not re.fullmatch(r"-?\d{1,9}", text, re.ASCII) or int(text) < low:
        raise ValueError(f"must be a whole number from {low} to {high}")
    return int(text)


def read_flag(text: str) -> bool:
    """A truth value in one of the spellings that clients use."""
    if text.lower() in ("true", "1", "yes", "on"):
        return True
    if text.lower() in ("false", "0", "no", "off"):
        return False
    raise ValueError("must be true or false")


def read_spectrum(text: str) -> Union[bool, str]:
    """A truth value, or ``sphere``."""
    if text == SPHERE:
        return SPHERE
    try:
        return read_flag(text)
    except ValueError:
        raise ValueError(f"must be true, false or {SPHERE}") from None


def read_sectors(text: str) -> tuple[tuple[float, float], ...]:
    """Sectors written as ``80:100,350:10``."""
    sentence = "must list sectors as from:to in degrees from -360 to 360, as 80:100,350:10"
    parts = text.split(",", MAX_SECTORS)
    if len(parts) > MAX_SECTORS:
        raise ValueError(f"may list at most {MAX_SECTORS} sectors")
    sectors = []
    for part in parts:
        if not re.fullmatch(r"\s*-?\d{1,3}(\.\d{1,6})?:-?\d{1,3}(\.\d{1,6})?\s*", part, re.ASCII):
            raise ValueError(sentence)
        first, last = map(float, part.split(":"))
        if max(abs(first), abs(last)) > 360 or (last - first) % 360 == 0:
            raise ValueError(f"{sentence}; none may be empty or the whole circle")
        sectors.append((first, last))
    return tuple(sectors)


def read_channel_map(text: str) -> tuple[int, ...]:
    """Channels as a JSON list or separated by commas."""
    sentence = "must list one whole number per microphone, as 1,2,3,4 or [1,2,3,4]"
    try:
        channels = json.loads(text if text.startswith("[") else f"[{text}]")
    except (ValueError, RecursionError):
        raise ValueError(sentence) from None
    if not channels or not all(type(channel) is int for channel in channels):
        raise ValueError(sentence)
    return tuple(channels)
