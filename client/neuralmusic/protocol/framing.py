"""Binary messages: PCM encodings and the optional 16-byte header with sequence and capture time."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

Encoding = Literal["pcm_s16le", "pcm_s24le", "pcm_s32le", "pcm_f32le"]
HeaderKind = Literal["none", "seq_time"]

SAMPLE_BYTES: dict[Encoding, int] = {
    "pcm_s16le": 2,
    "pcm_s24le": 3,
    "pcm_s32le": 4,
    "pcm_f32le": 4,
}
HEADER = struct.Struct("<IIq")
"""Little-endian u32 flags, u32 sequence, i64 capture time in nanoseconds; 16 bytes"""
SEQUENCE_MODULUS = 2**32
NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second; capture times are in nanoseconds"""


@dataclass(frozen=True)
class FrameHeader:
    """The header of a binary message with ``header: "seq_time"``."""

    sequence: int
    """Number of the binary message, modulo 2^32; a missing number is a gap"""
    capture_time_ns: int
    """Capture time of the message's first sample frame, by the robot's clock"""
    flags: int = 0
    """Reserved, zero; the service ignores it"""

    def pack(self) -> bytes:
        """The 16 bytes of the header."""
        return HEADER.pack(self.flags, self.sequence % SEQUENCE_MODULUS, self.capture_time_ns)

    @classmethod
    def unpack(cls, message: bytes) -> FrameHeader:
        """Read the first 16 bytes of a message of at least that length."""
        flags, sequence, capture_time_ns = HEADER.unpack_from(message)
        return cls(sequence, capture_time_ns, flags)
