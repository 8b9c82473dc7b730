"""The base of all messages: strict fields, and errors that name the field."""

from __future__ import annotations

from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from neuralmusic.errors import InvalidMessage, InvalidOption

M = TypeVar("M")
SHOWN = 60
"""Most characters of a client's value that an error repeats"""


class Message(BaseModel):
    """A message or a part of one; unknown fields are refused."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


def message_type(message: type[Message]) -> str:
    """The ``type`` of a kind of message."""
    return str(get_args(message.model_fields["type"].annotation)[0])


def read_message(text: str | bytes, adapter: TypeAdapter[M], known: list[str]) -> M:
    """One message from its JSON.

    Parameters
    ----------
    adapter : TypeAdapter
        Adapter of a union of messages with distinct ``type``.
    known : list of str
        The types of the union, for the error.

    Raises
    ------
    InvalidMessage
        If it is not JSON, or a field is unknown, missing or out of range.
    """
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        raise InvalidMessage(_sentence(error.errors(include_url=False)[0], known)) from None


def _sentence(error: ErrorDetails, known: list[str]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    place = ".".join(str(part) for part in error["loc"])
    if kind == "json_invalid":
        return f"the message is not valid JSON ({str(context.get('error', ''))[:SHOWN]})"
    if kind == "union_tag_not_found":
        return f"the message has no type: it is one of {', '.join(known)}"
    if kind == "union_tag_invalid":
        tag = str(context.get("tag", ""))[:SHOWN]
        return f"there is no message of type {tag!r}: it is one of {', '.join(known)}"
    if kind in ("model_type", "model_attributes_type"):
        return f"{place or 'the message'} must be a JSON object"
    if kind == "extra_forbidden":
        return f"{place[:SHOWN]} is not a field of this message: check its spelling"
    if kind == "missing":
        return f"{place} is missing"
    if kind == "value_error":
        return f"{place}: {context.get('error', error['msg'])}"
    value = repr(error["input"])
    shown = value if len(value) <= SHOWN else f"{value[:SHOWN]}…"
    said = error["msg"][:1].lower() + error["msg"][1:]
    return f"{place or 'the message'}: {said}, but is {shown}"


def plain(value: object) -> Any:
    """Models and numpy arrays as JSON; InvalidOption for anything else."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise InvalidOption(f"{type(value).__name__} cannot be sent as JSON")
