"""The first message of a stream, from the forms that a program may give."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import Enum
from typing import Any

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.client_messages import Start, read_client_message
from neuralmusic.protocol.message import plain


class Unchanged(Enum):
    """The type of ``UNCHANGED``, which stands for "leave as it is" where None is a value."""

    UNCHANGED = "unchanged"

    def __repr__(self) -> str:
        return self.name


UNCHANGED = Unchanged.UNCHANGED


def read_start(start: Start | None, fields: Mapping[str, Any]) -> Start:
    """The ``start`` message as given, or from its fields.

    ``array`` may be a preset's name alone, and values may be numpy arrays; None is not sent.

    Raises
    ------
    InvalidMessage
        If a field is unknown, missing or out of range.
    InvalidOption
        If both are given, or neither.
    """
    given = {name: value for name, value in fields.items() if value is not None}
    if start is not None:
        if given:
            raise InvalidOption(f"give a Start or its fields ({', '.join(given)}), not both")
        return start
    message: dict[str, Any] = {"type": "start", **given}
    if isinstance(message.get("array"), str):
        message["array"] = {"name": message["array"]}
    read = read_client_message(json.dumps(message, default=plain))
    assert isinstance(read, Start)
    return read
