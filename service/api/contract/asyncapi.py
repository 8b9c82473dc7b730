"""The stream's contract as AsyncAPI and as tables, both from the message models.

``python -m service.api.contract.asyncapi > asyncapi.json`` writes the one and
``python -m service.api.contract.asyncapi docs/protocol.md`` renews the others in that document.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic.json_schema import models_json_schema

from neuralmusic import __version__
from neuralmusic.errors import (
    UNEXPECTED,
    AudioBeforeStart,
    AudioQuota,
    ChannelMismatch,
    DoaError,
    Draining,
    GeometryMismatch,
    HostRefused,
    InvalidChannelMap,
    InvalidGeometry,
    InvalidMessage,
    InvalidOption,
    KeyExpired,
    KeyInAddress,
    KeyMissing,
    KeyUnknown,
    MessageTooBig,
    NotReady,
    OriginRefused,
    Overloaded,
    RoleMissing,
    SessionLimit,
    StreamTimeout,
    SubprotocolMissing,
    TooManyConnections,
    TooManyFrames,
    TooManySessions,
    TooManySources,
    UnknownArray,
    UnknownModel,
    WorkerLost,
)
from neuralmusic.protocol import MAX_MESSAGE_BYTES, SUBPROTOCOL
from neuralmusic.protocol.client_messages import CLIENT_MESSAGES
from neuralmusic.protocol.close_codes import REASONS, RETRYABLE, CloseCode
from neuralmusic.protocol.message import Message, message_type
from neuralmusic.protocol.server_messages import SERVER_MESSAGES

SECURITY_SCHEMES: dict[str, dict[str, str]] = {
    "key": {
        "type": "http",
        "scheme": "bearer",
        "description": "Where the service has keys: one with the role `stream`.",
    },
    "keyOfPage": {
        "type": "httpApiKey",
        "in": "header",
        "name": "Sec-WebSocket-Protocol",
        "description": f"For web pages, which can set no header: `{SUBPROTOCOL}` and "
        "`bearer.` with the key in base64url; the answer chooses the former.",
    },
}
HANDSHAKE_ERRORS: tuple[type[DoaError], ...] = (
    KeyInAddress,
    SubprotocolMissing,
    KeyMissing,
    KeyUnknown,
    KeyExpired,
    RoleMissing,
    OriginRefused,
    HostRefused,
    TooManySessions,
    AudioQuota,
    Overloaded,
    TooManyConnections,
    NotReady,
    Draining,
)
"""Errors that refuse a handshake, as a problem document before the connection is accepted"""
SESSION_ERRORS: tuple[type[DoaError], ...] = (
    AudioBeforeStart,
    TooManyFrames,
    MessageTooBig,
    WorkerLost,
    InvalidMessage,
    UnknownArray,
    InvalidGeometry,
    InvalidChannelMap,
    ChannelMismatch,
    UnknownModel,
    GeometryMismatch,
    InvalidOption,
    TooManySources,
    KeyUnknown,
    KeyExpired,
    RoleMissing,
    StreamTimeout,
    SessionLimit,
    TooManySessions,
    AudioQuota,
)
"""Errors that end a session, in the message ``error``; any other is ``DoaError`` itself"""
BEGIN, END = "<!-- messages: begin -->", "<!-- messages: end -->"
OPTIONAL = (
    "Every message has `type`. A field that is not required may be left out: it then has its "
    "default, or in `update` the value that it had."
)
COMPLETE = (
    "Every message has `type`, `seq`, which counts from 0, and all its fields; only `spectrum` can "
    "be absent."
)
REFERENCE = "#/components/schemas/{model}"


def document() -> dict[str, Any]:
    """The AsyncAPI 3.0 document of ``/stream``."""
    every = (*CLIENT_MESSAGES, *SERVER_MESSAGES)
    _, schemas = models_json_schema(
        [(message, "validation") for message in every], ref_template=REFERENCE
    )
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "NeuralMUSIC Service: streams",
            "version": __version__,
            "description": "Multichannel audio in, directions of arrival out, in real time. The "
            f"WebSocket subprotocol is {SUBPROTOCOL}. The first message is `start`; binary "
            f"messages of at most {MAX_MESSAGE_BYTES} bytes with whole sample frames follow. "
            "docs/protocol.md explains everything else.",
            "license": {"name": "Apache-2.0"},
        },
        "servers": {
            "robot": {
                "host": "127.0.0.1:8000",
                "protocol": "ws",
                "security": [_reference("securitySchemes", name) for name in SECURITY_SCHEMES],
            }
        },
        "channels": {
            "stream": {
                "address": "/stream",
                "messages": {
                    **{name: _reference("messages", name) for name in map(message_type, every)},
                    "audio": _reference("messages", "audio"),
                },
                "bindings": {"ws": {"method": "GET"}},
                "x-refused-handshakes": [_refusal(error) for error in HANDSHAKE_ERRORS],
            }
        },
        "operations": {
            "receiveFromClient": _operation(
                "receive", [*map(message_type, CLIENT_MESSAGES), "audio"]
            ),
            "sendToClient": _operation("send", map(message_type, SERVER_MESSAGES)),
        },
        "components": {
            "messages": {
                **{message_type(each): _message(each) for each in every},
                "audio": {
                    "summary": "Interleaved samples, after the 16-byte header where there is one.",
                    "contentType": "application/octet-stream",
                    "payload": {"type": "string", "format": "binary"},
                },
            },
            "securitySchemes": SECURITY_SCHEMES,
            "schemas": schemas["$defs"],
        },
    }


def _reference(kind: str, name: str) -> dict[str, str]:
    return {"$ref": f"#/components/{kind}/{name}"}


def _refusal(error: type[DoaError]) -> dict[str, Any]:
    """A problem document that may answer the handshake, as an extension: AsyncAPI has no place."""
    return {"status": error.status, "code": error.code, "summary": _why(error)}


def _why(error: type[DoaError]) -> str:
    return _text(error.__doc__ or "")


def _message(message: type[Message]) -> dict[str, Any]:
    return {
        "summary": _first_sentence(message.__doc__ or ""),
        "contentType": "application/json",
        "payload": {"$ref": REFERENCE.format(model=message.__name__)},
    }


def _operation(action: str, names: Iterable[str]) -> dict[str, Any]:
    return {
        "action": action,
        "channel": {"$ref": "#/channels/stream"},
        "messages": [{"$ref": f"#/channels/stream/messages/{name}"} for name in names],
    }


def document_json() -> str:
    """The document as it is checked in and served."""
    return json.dumps(document(), indent=2, ensure_ascii=False) + "\n"


def tables() -> str:
    """Every message with its fields, and the close codes, as Markdown."""
    schemas = document()["components"]["schemas"]
    lines = ["## From the client", "", OPTIONAL, ""]
    for message in CLIENT_MESSAGES:
        lines += _table(message, schemas, presence=True)
    lines += ["## From the server", "", COMPLETE, ""]
    for message in SERVER_MESSAGES:
        lines += _table(message, schemas, presence=False)
    lines += ["## Errors", "", "### Refused handshakes", "", "| status | `code` | why |"]
    lines.append("|---|---|---|")
    lines += [f"| {e.status} | `{e.code}` | {_why(e)} |" for e in HANDSHAKE_ERRORS]
    lines += ["", "### Errors of a session", "", "| close code | `code` | why | retry |"]
    lines.append("|---|---|---|---|")
    for error in SESSION_ERRORS:
        retry = "yes" if error.retryable or error.close_code in RETRYABLE else ""
        lines.append(f"| {error.close_code} | `{error.code}` | {_why(error)} | {retry} |")
    lines += [
        f"| {DoaError.close_code} | `{DoaError.code}` | {UNEXPECTED.capitalize()}. | yes |",
        "",
    ]
    lines += ["## Close codes", "", "| code | why | retry |", "|---|---|---|"]
    for code in CloseCode:
        lines.append(f"| {code} | {REASONS[code]} | {'yes' if code in RETRYABLE else ''} |")
    return "\n".join([*lines, ""])


def _table(message: type[Message], schemas: Mapping[str, Any], *, presence: bool) -> list[str]:
    """One message's heading and fields; with ``presence`` also which fields may be left out."""
    heading = [f"### `{message_type(message)}`", "", _text(message.__doc__ or ""), ""]
    rows = list(_rows(schemas[message.__name__], schemas, presence))
    if not rows:
        return heading
    return [*heading, "| field | type | meaning |", "|---|---|---|", *rows, ""]


def _rows(
    schema: Mapping[str, Any], schemas: Mapping[str, Any], presence: bool, prefix: str = ""
) -> Iterator[str]:
    for name, field in schema.get("properties", {}).items():
        if name in ("type", "seq") and not prefix:
            continue
        kind, parts = _kind(field, schemas)
        given = _presence(field, name in schema.get("required", ())) if presence else ""
        meaning = _text(field.get("description", ""))
        yield f"| `{prefix}{name}` | {kind}{given} | {meaning} |"
        if parts is not None:
            brackets = "[]" if kind.startswith("list") else ""
            yield from _rows(parts, schemas, presence, f"{prefix}{name}{brackets}.")


def _presence(field: Mapping[str, Any], required: bool) -> str:
    """Whether a client must give a field, and what it is otherwise."""
    if required:
        return ", required"
    if "default" not in field or isinstance(field["default"], dict):
        return ", optional"
    return f", default `{json.dumps(field['default'])}`"


def _kind(
    field: Mapping[str, Any], schemas: Mapping[str, Any]
) -> tuple[str, Mapping[str, Any] | None]:
    """A field's type in words, and the schema of the object that it holds, if it is one."""
    if "$ref" in field:
        return "object", schemas[field["$ref"].rpartition("/")[2]]
    if "anyOf" in field:
        kinds = [_kind(each, schemas) for each in field["anyOf"]]
        return " or ".join(kind for kind, _ in kinds), next((p for _, p in kinds if p), None)
    if "enum" in field:
        return " or ".join(f"`{value}`" for value in field["enum"]), None
    if "const" in field:
        return f"`{field['const']}`", None
    if field.get("type") == "array":
        inner = field.get("items") or (field.get("prefixItems") or [{}])[0]
        kind, parts = _kind(inner, schemas)
        return f"list of {kind}", parts
    bounds = [str(field[key]) for key in ("minimum", "maximum") if key in field]
    span = f" {' to '.join(bounds)}" if len(bounds) == 2 else ""
    return f"{field.get('type', 'any')}{span}", None


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.:]) ", _text(text))[0]


def _text(text: str) -> str:
    return " ".join(text.replace("``", "`").replace("|", "\\|").split())


def main(arguments: list[str]) -> int:
    """Print the document, or renew the tables of a Markdown file."""
    if not arguments:
        sys.stdout.write(document_json())
        return 0
    path = Path(arguments[0])
    path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


def renewed(text: str) -> str:
    """A Markdown document with the tables as they are now."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{tables()}{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
