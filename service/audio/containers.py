"""The size that an AIFF, AU or W64 header promises.

libsndfile shortens a recording silently where the header promises more than the file holds. WAV
files are looked at more closely (``wav``); FLAC and MP3 decoders notice themselves, and the other
formats do not say.
"""

from __future__ import annotations

import struct

HEAD_BYTES = 24
"""Bytes needed to recognise the format"""
UNKNOWN_SIZE = 0x7F00_0000
"""Smallest 32-bit length that means a recorder wrote into a pipe"""
_W64 = b"riff\x2e\x91\xcf\x11\xa5\xd6\x28\xdb\x04\xc1\x00\x00"


def promised_bytes(head: bytes) -> int:
    """Bytes of the whole file by its first ``HEAD_BYTES``; 0 where they do not say."""
    if len(head) < HEAD_BYTES:
        return 0
    if head[:4] == b"FORM" and head[8:12] in (b"AIFF", b"AIFC"):
        size = struct.unpack(">I", head[4:8])[0]
        return 8 + size if size < UNKNOWN_SIZE else 0
    if head[:4] == b".snd":
        start, size = struct.unpack(">II", head[4:12])
        return start + size if size < UNKNOWN_SIZE else 0
    if head[:16] == _W64:
        return int(struct.unpack("<Q", head[16:24])[0])
    return 0
