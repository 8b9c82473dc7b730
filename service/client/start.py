"""The first message of a stream, from whatever a program gives for it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from service.errors import InvalidOption
from service.protocol.client_messages import Start, read_client_message


def read_start(start: Start | None, fields: Mapping[str, Any]) -> Start:
    """The ``start`` message from itself or from its fields.

    ``array`` may be a preset's name alone, and values may be numpy arrays.

    Raises
    ------
    InvalidMessage
        If a field is unknown, missing or out of range.
    InvalidOption
        If both are given, or none.
    """
    if start is not None:
        if fields:
            raise InvalidOption(f"give a Start or its fields ({', '.join(fields)}), not both")
        return start
    message: dict[str, Any] = {"type": "start", **fields}
    if isinstance(message.get("array"), str):
        message["array"] = {"name": message["array"]}
    read = read_client_message(json.dumps(message, default=plain))
    assert isinstance(read, Start)
    return read


def plain(value: object) -> Any:
    """Models and numpy arrays as JSON; InvalidOption for anything else."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise InvalidOption(f"{type(value).__name__} cannot be sent as JSON")
