"""The mutated streams: an index gives the same bytes, always."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

import numpy as np

from . import frames, messages
from .uploads import SEED

STOP = frames.frame(frames.TEXT, b'{"type":"stop"}')
HEADERS = (
    ("Host", "localhost"),
    ("Upgrade", "websocket"),
    ("Connection", "Upgrade"),
    ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Protocol", "doa.v1"),
)
REQUESTS = (
    "POST /stream HTTP/1.1",
    "GET /stream HTTP/1.0",
    "GET //stream HTTP/1.1",
    f"GET /stream?{'q' * 3000} HTTP/1.1",
    "GET /str\xe9am HTTP/1.1",
    "GET /stream?\xff HTTP/1.1",
    "GET /localize HTTP/1.1",
    "FROB /stream HTTP/1.1",
)


@dataclass(frozen=True, slots=True)
class Conversation:
    """All that a client sends."""

    index: int
    what: str
    handshake: bytes
    content: bytes
    """Bytes after an accepted handshake"""
    patient: bool = False
    """Whether the server may have to wait for the rest: the client then leaves"""


def conversation(index: int) -> Conversation:
    """The mutant of this index."""
    random = Random(f"{SEED}:stream:{index}")
    aim = random.random()
    if aim < 0.08:
        handshake, what, patient = _bad_handshake(random)
        return Conversation(index, what, handshake, _valid(random) + STOP, patient)
    handshake = _handshake(HEADERS)
    if aim < 0.45:
        content, what = _bad_message(random)
        return Conversation(index, what, handshake, content + STOP)
    if aim < 0.6:
        content, what = _bad_audio(random)
        return Conversation(index, what, handshake, content + STOP)
    if aim < 0.8:
        content, what = _bad_order(random)
        return Conversation(index, what, handshake, content + STOP)
    broken, what, patient = frames.broken(random)
    script = _script(random)
    place = random.randrange(len(script) + 1)
    content = b"".join((*script[:place], broken, *script[place:]))
    # What follows half a frame is taken for the rest of it.
    return Conversation(index, f"frame: {what}", handshake, content + STOP, patient)


def _bad_message(random: Random) -> tuple[bytes, str]:
    """A conversation in which some control messages are wrong."""
    script = [messages.start() if random.random() < 0.5 else messages.tuned(random)]
    script += random.choices(messages.CONTROLS[:-1], k=random.choice((0, 1, 4)))
    place = random.randrange(len(script))
    texts = [json.dumps(message) for message in script]
    texts[place] = messages.spoiled(script[place], random)
    sent = []
    for text in texts:
        sent += [_text(text, random), *_audio(random)]
    return b"".join(sent), f"{script[place]['type']} spoiled"


def _bad_audio(random: Random) -> tuple[bytes, str]:
    """Audio that is invalid, or not as announced."""
    begin = messages.start() if random.random() < 0.4 else messages.tuned(random)
    timed = begin["audio"].get("header") == "seq_time"
    sent = [_text(json.dumps(begin), random)]
    for number in range(random.choice((1, 3, 12))):
        size = random.choice(
            (0, 1, 7, 8, 15, 16, 24, 800, 6400, 6401, 65_536, 262_144, 262_145, 300_000)
        )
        data = random.choice(
            (noise()[:size], bytes(size), b"\xff" * size, b"\x00\x00\xc0\x7f" * (size // 4))
        )
        if random.random() < 0.1:
            data = random.choice((b"RIFF", b"fLaC", b"OggS", b"FORM")) + data
        if timed and random.random() < 0.9:
            sequence = random.choice((number, number, number + 5, 0, 2**32 - 1, 2**31))
            captured = random.choice((number * 50_000_000, 0, -(2**63), 2**63 - 1, 10**18))
            data = struct.pack("<IIq", random.choice((0, 0, 2**32 - 1)), sequence, captured) + data
        sent.append(frames.frame(frames.BINARY, data))
    return b"".join(sent), f"audio {begin['audio']['encoding']}"


def _bad_order(random: Random) -> tuple[bytes, str]:
    """Right messages in a wrong order, too many of them, or in strange frames."""
    script = _script(random)
    what = random.choice(
        ("shuffled", "doubled", "pings", "pieces", "closes", "controls", "after stop")
    )
    if what == "shuffled":
        random.shuffle(script)
    elif what == "doubled":
        script = script * 2
    elif what == "pings":
        script.insert(1, frames.frame(frames.PING, b"p" * random.choice((0, 125))) * 3000)
        script.insert(2, frames.frame(frames.PONG, b"unasked") * 300)
    elif what == "pieces":
        data = noise()[:6400]
        script.append(frames.fragmented(frames.BINARY, data, random))
        script.append(frames.frame(frames.BINARY, b"", fin=False))
        script += [frames.frame(frames.CONTINUATION, b"", fin=False)] * 500
        script.append(frames.frame(frames.CONTINUATION, data))
    elif what == "closes":
        script.insert(
            random.randrange(len(script) + 1),
            frames.close(random.choice((None, 1000, 1001, 1011, 3000, 4999)), b"bye"),
        )
    elif what == "controls":
        many = json.dumps(random.choice(messages.CONTROLS)).encode()
        script.insert(random.choice((0, 1)), frames.frame(frames.TEXT, many) * 600)
    else:
        script.insert(random.randrange(len(script) + 1), STOP)
    return b"".join(script), what


def _bad_handshake(random: Random) -> tuple[bytes, str, bool]:
    """A handshake that is refused or invalid."""
    headers = dict(HEADERS)
    what = random.choice(("half", "without", "changed", "long", "method", "body", "repeated"))
    request = "GET /stream HTTP/1.1"
    if what == "half":
        whole = _handshake(HEADERS)
        return whole[: random.randrange(len(whole))], "half a handshake", True
    name = random.choice(tuple(headers))
    if what == "without":
        del headers[name]
    elif what == "changed":
        odd = ("", "x", "12", "doa.v2", "doa.v1, doa.v1", "doa.v1,", "é", "h2c", "AAAA", "a" * 9000)
        headers[name] = random.choice(odd)
    elif what == "long":
        headers |= {f"X-{index}": "y" * 100 for index in range(random.choice((10, 600)))}
    elif what == "method":
        request = random.choice(REQUESTS)
    elif what == "body":
        headers["Content-Length"] = random.choice(("0", "5", "-1", "99999999999"))
    else:
        return _handshake((*HEADERS, random.choice(HEADERS)), request), "repeated", True
    return _handshake(tuple(headers.items()), request), f"handshake {what} {name}", True


def _valid(random: Random) -> bytes:
    return b"".join(_script(random))


def _script(random: Random) -> list[bytes]:
    """A right conversation but for its end, a frame or several each."""
    begin = messages.start() if random.random() < 0.8 else messages.tuned(random)
    script = [_text(json.dumps(begin), random)]
    for _ in range(random.choice((0, 2, 5))):
        script += _audio(random)
        script.append(_text(json.dumps(random.choice(messages.CONTROLS[:-1])), random))
    return script


def _audio(random: Random) -> list[bytes]:
    return [
        frames.frame(frames.BINARY, noise()[: 8 * random.choice((80, 800, 1600))])
        for _ in range(random.choice((0, 1, 3)))
    ]


def _text(text: str, random: Random) -> bytes:
    payload = text.encode("utf-8", "surrogatepass")
    if random.random() < 0.1:
        return frames.fragmented(frames.TEXT, payload, random)
    return frames.frame(frames.TEXT, payload)


def _handshake(
    headers: tuple[tuple[str, str], ...], request: str = "GET /stream HTTP/1.1"
) -> bytes:
    lines = (request, *(f"{name}: {value}" for name, value in headers), "", "")
    return "\r\n".join(lines).encode("latin-1")


@cache
def noise() -> bytes:
    """Half a second of four channels."""
    samples: Any = np.random.default_rng(0).integers(-300, 300, (20_000, 4))
    return bytes(samples.astype("<i2").tobytes())
