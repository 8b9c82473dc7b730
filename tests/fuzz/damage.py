"""Damage to recordings: every function takes a recording and a source of chance."""

from __future__ import annotations

import struct
from collections.abc import Callable
from random import Random

from .seeds import seeds

Damage = Callable[[bytes, Random], bytes]

NUMBERS = (
    *(0, 1, 2, 3, 4, 7, 8, 15, 16, 17, 24, 31, 32, 33, 63, 64, 65, 127, 128, 255, 256, 1024),
    *(3999, 4000, 8000, 44_100, 48_000, 384_000, 384_001, 65_534, 65_535, 65_536, 10**7),
    *(2**24 - 1, 2**31 - 256, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - 8, 2**32 - 2, 2**32 - 1),
    *(2**33, 2**48, 2**62, 2**63 - 1, 2**63, 2**64 - 1),
)
"""Numbers at which readers of headers go wrong"""
IDS = (
    *(b"RIFF", b"RIFX", b"RF64", b"BW64", b"WAVE", b"fmt ", b"data", b"ds64", b"LIST", b"fact"),
    *(b"bext", b"cart", b"cue ", b"smpl", b"inst", b"PEAK", b"id3 ", b"ID3\x04", b"JUNK", b"acid"),
    *(b"FORM", b"AIFF", b"AIFC", b"COMM", b"SSND", b"MARK", b"INST", b"caff", b"desc", b"pakt"),
    *(b"chan", b"kuki", b"fLaC", b"OggS", b".snd", b"riff", b"NIST", b"2BIT", b"MATL", b"\0" * 4),
)
"""Names of chunks and magic numbers of all formats"""
HEADER_BYTES = 256


def flip_bits(content: bytes, random: Random) -> bytes:
    """A few bits anywhere, most of them in the header."""
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 4, 16, 64))):
        span = HEADER_BYTES if random.random() < 0.6 else len(changed)
        changed[random.randrange(min(span, len(changed)))] ^= 1 << random.randrange(8)
    return bytes(changed)


def set_number(content: bytes, random: Random) -> bytes:
    """A telling number where the header may have one."""
    form = random.choice(("<H", ">H", "<I", ">I", "<I", ">I", "<Q", ">Q"))
    size = struct.calcsize(form)
    if len(content) < size:
        return content
    place = random.randrange(min(HEADER_BYTES, len(content) - size) + 1) & ~random.choice((0, 1, 3))
    number = random.choice(NUMBERS) % 2 ** (8 * size)
    return content[:place] + struct.pack(form, number) + content[place + size :]


def set_id(content: bytes, random: Random) -> bytes:
    """Another chunk's name where one is."""
    places = [content.find(name) for name in IDS[:-1]]
    place = random.choice([p for p in places if p >= 0] or [0])
    return content[:place] + random.choice(IDS) + content[place + 4 :]


def truncate(content: bytes, random: Random) -> bytes:
    """Only the beginning, or only the end."""
    span = HEADER_BYTES if random.random() < 0.4 else len(content)
    place = random.randrange(min(span, len(content)) + 1)
    return content[place:] if random.random() < 0.1 else content[:place]


def repeat(content: bytes, random: Random) -> bytes:
    """A piece twice, or many times."""
    begin, end = piece(content, random)
    times = random.choice((1, 1, 2, 8, 100))
    return (
        content[:end]
        + content[begin:end] * min(times, 2**18 // max(end - begin, 1))
        + content[end:]
    )


def remove(content: bytes, random: Random) -> bytes:
    """Without a piece."""
    begin, end = piece(content, random)
    return content[:begin] + content[end:]


def fill(content: bytes, random: Random) -> bytes:
    """A piece of zeros, of ones, of chance, or of another place."""
    begin, end = piece(content, random)
    length = end - begin
    filling = random.choice((bytes(length), b"\xff" * length, random.randbytes(length)))
    return content[:begin] + filling + content[end:]


def splice(content: bytes, random: Random) -> bytes:
    """The beginning of one format, the end of another."""
    other = random.choice(seeds()).content
    place = random.choice(
        (random.randrange(len(content) + 1), min(random.randrange(1, 128), len(content)))
    )
    return content[:place] + other[random.choice((0, random.randrange(len(other)))) :]


def add_chunks(content: bytes, random: Random) -> bytes:
    """Chunks with lengths that are true, false or absurd; sometimes more than anybody has."""
    order = "<" if random.random() < 0.7 else ">"
    count = random.choice((1, 1, 2, 300, 3000))
    parts = []
    for _ in range(count):
        body = random.randbytes(random.choice((0, 1, 4, 24, 40)))
        length = len(body) if random.random() < 0.8 else random.choice(NUMBERS) % 2**32
        parts.append(random.choice(IDS) + struct.pack(f"{order}I", length) + body)
    place = random.choice((12, 36, 12, len(content), random.randrange(len(content) + 1)))
    return content[:place] + b"".join(parts) + content[place:]


def copy_chunk(content: bytes, random: Random) -> bytes:
    """A chunk twice, or one inside of another."""
    names = [name for name in IDS[:-1] if name in content]
    if not names:
        return content
    begin = content.index(random.choice(names))
    chunk = content[begin : begin + 8 + random.choice((4, 16, 24, 40))]
    place = content.index(random.choice(names)) + random.choice((0, 8, 12))
    return content[:place] + chunk * random.choice((1, 2, 50)) + content[place:]


def tag(content: bytes, random: Random) -> bytes:
    """An ID3 tag in front, whose length may be a lie."""
    body = random.randbytes(random.choice((0, 10, 200)))
    length = random.choice((len(body), len(body), 2**28 - 1, 0, random.choice(NUMBERS) % 2**28))
    coded = bytes((length >> shift) & 0x7F for shift in (21, 14, 7, 0))
    head = b"ID3" + bytes((random.choice((2, 3, 4, 255)), 0, random.randrange(256))) + coded
    return (head + body) * random.choice((1, 1, 3, 200)) + content


def set_samples(content: bytes, random: Random) -> bytes:
    """Floats at which arithmetic goes wrong, anywhere in the audio."""
    changed = bytearray(content)
    values = (float("nan"), float("inf"), -float("inf"), 3e38, 1e-42, 9.9e6, -1e7)
    for _ in range(random.choice((1, 1, 3, 200))):
        if len(changed) > 100:
            place = random.randrange(92, len(changed) - 4) & ~3
            struct.pack_into("<f", changed, place, random.choice(values))
    return bytes(changed)


def replace_all(content: bytes, random: Random) -> bytes:
    """Nothing but chance behind a magic number."""
    return random.choice(IDS) + random.randbytes(random.choice((0, 8, 40, 4000)))


DAMAGES: tuple[Damage, ...] = (
    *(flip_bits, set_number, set_number, set_number, set_id, truncate, repeat, remove, fill),
    *(splice, add_chunks, copy_chunk, tag, set_samples, replace_all),
)


def damaged(content: bytes, random: Random) -> tuple[bytes, str]:
    """One to three damages, and what they are called."""
    names = []
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        damage = random.choice(DAMAGES)
        content = damage(content, random)
        names.append(damage.__name__)
    return content, "+".join(names)


def piece(content: bytes, random: Random) -> tuple[int, int]:
    """Start and end of a piece."""
    begin = random.randrange(len(content) + 1)
    return begin, min(len(content), begin + random.choice((1, 2, 4, 8, 36, 512, 4096)))
