"""WebSocket frames by hand: right ones to the server, and such as no library sends."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from random import Random

CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG = 0, 1, 2, 8, 9, 10
MASK = b"\x5a\x00\xa5\x42"


def frame(
    opcode: int, payload: bytes, *, fin: bool = True, rsv: int = 0, masked: bool = True
) -> bytes:
    """One frame from the client."""
    head = bytes(((fin << 7) | (rsv << 4) | opcode,)) + _length(len(payload), masked)
    if not masked:
        return head + payload
    return head + MASK + _mask(payload)


def _length(length: int, masked: bool) -> bytes:
    bit = masked << 7
    if length < 126:
        return bytes((bit | length,))
    if length < 2**16:
        return bytes((bit | 126,)) + struct.pack(">H", length)
    return bytes((bit | 127,)) + struct.pack(">Q", length)


def _mask(payload: bytes) -> bytes:
    repeated = MASK * (len(payload) // 4 + 1)
    number = int.from_bytes(payload, "big") ^ int.from_bytes(repeated[: len(payload)], "big")
    return number.to_bytes(len(payload), "big")


def fragmented(opcode: int, payload: bytes, random: Random) -> bytes:
    """A message in pieces, with pings between them."""
    places = sorted(random.randrange(len(payload) + 1) for _ in range(random.choice((1, 3, 40))))
    edges = [0, *places, len(payload)]
    pieces = [payload[begin:end] for begin, end in pairwise(edges)]
    sent = frame(opcode, pieces[0], fin=False)
    for piece in pieces[1:-1]:
        sent += frame(CONTINUATION, piece, fin=False)
        if random.random() < 0.2:
            sent += frame(PING, b"between")
    return sent + frame(CONTINUATION, pieces[-1])


def close(code: int | None, reason: bytes = b"") -> bytes:
    """A close frame."""
    return frame(CLOSE, b"" if code is None else struct.pack(">H", code) + reason)


def broken(random: Random) -> tuple[bytes, str, bool]:
    """Bytes that break RFC 6455, what they are, and whether the server has to wait for more."""
    payload = random.randbytes(random.choice((0, 3, 130)))
    cases: tuple[tuple[bytes, str, bool], ...] = (
        (frame(TEXT, b'{"type":"ping"}', rsv=random.choice((1, 2, 4, 7))), "rsv", False),
        (frame(random.choice((3, 4, 7, 11, 15)), payload), "opcode", False),
        (frame(BINARY, payload, masked=False), "unmasked", False),
        (frame(TEXT, b"\xff\xfe" + payload), "utf-8", False),
        (frame(TEXT, b'{"type":"ping", "\xed\xa0\x80"}'), "surrogate", False),
        (frame(CONTINUATION, payload), "continuation", False),
        (frame(TEXT, b"a", fin=False) + frame(TEXT, b"b"), "interleaved", False),
        (frame(PING, b"x" * 126), "long ping", False),
        (frame(PING, b"x", fin=False), "ping in pieces", False),
        (frame(CLOSE, b"\x03"), "close of one byte", False),
        (close(random.choice((0, 999, 1004, 1005, 1006, 1015, 2999, 5000, 65535))), "code", False),
        (close(1000, b"\xff\xff"), "reason", False),
        (b"\x82\xff" + struct.pack(">Q", 2**63) + MASK, "length of 2^63", False),
        (b"\x82\xff" + struct.pack(">Q", 2**40) + MASK, "length of 2^40", False),
        (b"\x82\xfe\x00\x05" + MASK + b"12345", "length too long", True),
        (frame(BINARY, bytes(2**20 + 8)), "more than 1 MiB", False),
        (frame(BINARY, payload)[: -1 - len(payload) // 2], "half a frame", True),
        (b"\x81", "one byte", True),
        (b"GET / HTTP/1.1\r\n\r\n", "HTTP", True),
        (random.randbytes(random.choice((8, 200))), "chance", True),
    )
    return random.choice(cases)


@dataclass(slots=True)
class Received:
    """One frame from the server."""

    opcode: int
    payload: bytes


def take_frames(data: bytearray) -> list[Received]:
    """Remove the whole frames at the beginning; ValueError where they are no server's."""
    found = []
    while len(data) >= 2:
        first, length, start = data[0], data[1], 2
        if first & 0x70 or length & 0x80 or not first & 0x80:
            raise ValueError(f"a frame begins with {data[:2].hex()}")
        if length >= 126:
            start = 4 if length == 126 else 10
            if len(data) < start:
                break
            length = int.from_bytes(data[2:start], "big")
        if len(data) < start + length:
            break
        found.append(Received(first & 0x0F, bytes(data[start : start + length])))
        del data[: start + length]
    return found
