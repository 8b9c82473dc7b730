"""What a server says in a stream, and whether it may."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from neuralmusic.protocol.close_codes import CloseCode

from .conversations import Conversation
from .frames import CLOSE, PONG, TEXT, close, take_frames

DOCUMENT = json.loads((Path(__file__).parents[2] / "asyncapi.json").read_text())
BY_RFC_6455 = {1002, 1007, 1009}
"""Close codes for invalid frames, which no message precedes"""
DEFECTS = {"internal", "worker_lost"}


@dataclass
class Said:
    """Everything that came from the server."""

    status: int | None = None
    """Status of the handshake's response; None where none came"""
    head: str = ""
    messages: list[dict[str, Any]] = field(default_factory=list)
    close_code: int | None = None
    """Code of the close frame, 1005 where it had none; None where no frame came"""
    ended: bool = False
    """Whether the server closed, or refused the handshake"""

    @property
    def outcome(self) -> str:
        """In a few words."""
        if self.status != 101:
            return f"handshake {self.status or 'unfinished'}"
        code = next((m["code"] for m in self.messages[-1:] if "close_code" in m), None)
        return f"{self.close_code or 'open'}{f' {code}' if code else ''}"


async def converse(address: tuple[str, int], each: Conversation, said: Said) -> None:
    """Send all of a conversation, listen until the server ends it."""
    reader, writer = await asyncio.open_connection(*address)
    try:
        writer.write(each.handshake)
        said.head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
        said.status = int(said.head.split(" ", 2)[1])
        if said.status != 101:
            said.ended = True
            return
        writer.write(each.content)
        await _listen(reader, writer, said)
    except (ConnectionError, asyncio.IncompleteReadError):
        said.ended = True
    finally:
        writer.transport.abort()


async def _listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, said: Said) -> None:
    waiting = bytearray()
    while data := await reader.read(2**16):
        waiting += data
        for frame in take_frames(waiting):
            if frame.opcode == TEXT:
                said.messages.append(json.loads(frame.payload))
            elif frame.opcode == CLOSE:
                said.close_code = int.from_bytes(frame.payload[:2], "big") or 1005
                said.ended = True
                writer.write(close(1000))
                with suppress(ConnectionError):
                    await writer.drain()
                return
            elif frame.opcode != PONG:
                raise ValueError(f"a frame with opcode {frame.opcode}")
    said.ended = True


def complaint(said: Said, each: Conversation) -> str | None:
    """What is wrong with what was said; None where all is as documented."""
    if said.status is not None and said.status >= 500 and "retry-after" not in said.head.lower():
        return f"the handshake gave {said.status}"
    for number, message in enumerate(said.messages):
        error = next(validator(message["type"]).iter_errors(message), None)
        if error is not None:
            return f"{message['type']}: {error.message[:200]}"
        if number and message["seq"] <= said.messages[number - 1]["seq"]:
            return f"seq {message['seq']} after {said.messages[number - 1]['seq']}"
        if message.get("code") in DEFECTS:
            return f"{message['code']}: {message['detail']}"
    ends = [message for message in said.messages if message["type"] in ("error", "closing")]
    if len(ends) > 1 or (ends and said.messages[-1] is not ends[0]):
        return f"{len(ends)} ends, the last message is {said.messages[-1]['type']}"
    if said.close_code is None:
        return None
    if ends:
        right = said.close_code == ends[0]["close_code"] and said.close_code in set(CloseCode)
        return None if right else f"{said.close_code} after {ends[0]['close_code']}"
    # Without a message: a frame that was none, or the client's own close frame given back.
    if said.close_code in BY_RFC_6455 or each.what == "closes":
        return None
    return f"closed with {said.close_code} and no word"


@cache
def validator(kind: str) -> Draft202012Validator:
    """Validator of one kind of message."""
    payload = DOCUMENT["components"]["messages"][kind]["payload"]
    return Draft202012Validator({**payload, "components": DOCUMENT["components"]})
