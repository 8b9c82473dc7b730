"""What a WAV header promises, read without any library.

libsndfile silently shortens a recording whose WAV header promises more than the file holds, and
sets no limit on what a header may claim; a service has to notice both.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from io import SEEK_CUR, SEEK_END
from typing import BinaryIO

from neuralmusic.protocol.framing import Encoding

MAX_CHUNKS = 256
"""Most chunks read before the audio; more are an attack"""

LEAST_UNKNOWN = 0x7FFF_0000
"""Least length that a recorder writes into a pipe, where it does not know the true one: sox and
arecord about 2^31, ffmpeg 2^32 - 1. GStreamer writes 0"""
IN_DS64 = 0xFFFF_FFFF
"""Length in an RF64 or BW64 file that stands for the true one in the ds64 chunk"""
LARGEST_RIFF = 0x7FFF_0000
"""Bytes of audio beyond which a rewritten header is RF64's"""
AMBISONIC = bytes.fromhex("2107d3118644c8c1ca000000")
"""End of the GUIDs by which a WAV file says that its channels are ambisonic B-format"""

EXTENSIBLE = 0xFFFE
"""Format that stands for the true one at the beginning of a GUID"""

_ENCODINGS: dict[tuple[int, int], Encoding] = {
    (1, 16): "pcm_s16le",
    (1, 24): "pcm_s24le",
    (1, 32): "pcm_s32le",
    (3, 32): "pcm_f32le",
}
"""Encodings by format and bits per sample"""
_BYTE_ORDER = {b"RIFF": "<", b"RF64": "<", b"BW64": "<", b"RIFX": ">"}
_LONG = (b"RF64", b"BW64")


@dataclass(frozen=True)
class WavHeader:
    """What a WAV header claims and what the file holds."""

    channels: int
    sample_rate: int
    """Hertz"""
    frame_bytes: int
    """Bytes per sample frame of all channels"""
    encoding: Encoding | None
    """Encoding of the samples; None where a stream cannot take them as they are"""
    start: int
    """Bytes from the start of the file to its audio"""
    promised: int
    """Bytes of audio that the header promises"""
    held: int
    """Bytes of audio in the file, from the start of the audio to the end"""
    open_ended: bool
    """True where a recorder wrote into a pipe: the audio lasts to the end of the file"""
    plain: bool
    """True where libsndfile reads the file as it is"""
    fmt: bytes
    """The chunk that describes the samples"""

    @property
    def truncated(self) -> bool:
        """True where at least one whole sample frame is missing."""
        missing = self.promised - self.held
        return not self.open_ended and missing >= max(self.frame_bytes, 1)

    @property
    def ambisonic(self) -> bool:
        """True where the channels are ambisonic, no microphones."""
        return self.fmt.endswith(AMBISONIC)

    @property
    def rewritten(self) -> bytes:
        """The shortest header of the same audio, little endian, in its true length."""
        size = self.held - self.held % max(self.frame_bytes, 1)
        fmt = struct.pack("<4sI", b"fmt ", len(self.fmt)) + self.fmt
        if size <= LARGEST_RIFF:
            whole = 4 + len(fmt) + 8 + size
            return struct.pack("<4sI4s", b"RIFF", whole, b"WAVE") + fmt + _data(size)
        whole = 4 + 36 + len(fmt) + 8 + size
        ds64 = struct.pack("<4sIQQQI", b"ds64", 28, whole, size, 0, 0)
        return struct.pack("<4sI4s", b"RF64", IN_DS64, b"WAVE") + ds64 + fmt + _data(IN_DS64)


def read_wav_header(file: BinaryIO) -> WavHeader | None:
    """The header of a WAV file; None for another format or a file that ends before its audio."""
    file.seek(0, SEEK_END)
    end = file.tell()
    file.seek(0)
    magic, order, riff_bytes = _riff(file.read(12))
    if not magic:
        return None
    fmt: tuple[int, int, int, Encoding | None] | None = None
    chunk = b""
    plain = magic != b"BW64"
    long_size = 0
    for _ in range(MAX_CHUNKS):
        head = file.read(8)
        if len(head) < 8:
            return None
        name, size = struct.unpack(f"{order}4sI", head)
        start = file.tell()
        if name == b"fmt ":
            chunk = file.read(min(size, 40))
            fmt = _fmt(chunk, order)
        elif name == b"ds64":
            long_size = _ds64(file.read(16), order)
        elif name == b"data":
            if fmt is None:
                return None
            in_ds64 = magic in _LONG and size == IN_DS64
            promised = long_size if in_ds64 else size
            unknown = promised in (0, 2**64 - 1) if in_ds64 else _unknown(size, riff_bytes)
            return WavHeader(
                *fmt,
                start=start,
                promised=promised,
                held=end - start,
                open_ended=unknown and end > start,
                plain=plain and not unknown,
                fmt=chunk,
            )
        file.seek(start)
        file.seek(size, SEEK_CUR)
        if size % 2:  # chunks start at even places, but some writers forget the byte between
            between = file.read(5)
            padded = not (between[:4].isalnum() or between[:4] in (b"fmt ", b"id3 "))
            plain = plain and padded
            file.seek(start + size + padded)
    return None


def is_wav(start: bytes) -> bool:
    """True where a file with these first bytes, at least twelve, calls itself a WAV file."""
    return bool(_riff(start)[0])


def _riff(head: bytes) -> tuple[bytes, str, int]:
    magic = head[:4]
    if len(head) < 12 or magic not in _BYTE_ORDER or head[8:12] != b"WAVE":
        return b"", "<", 0
    order = _BYTE_ORDER[magic]
    return magic, order, struct.unpack(f"{order}I", head[4:8])[0]


def _unknown(size: int, riff_bytes: int) -> bool:
    """Whether the lengths of the audio and of the file are none."""
    if size == 0:
        return riff_bytes == 0 or riff_bytes >= LEAST_UNKNOWN
    return size >= LEAST_UNKNOWN and (riff_bytes == 0 or riff_bytes >= LEAST_UNKNOWN)


def _data(size: int) -> bytes:
    return struct.pack("<4sI", b"data", size)


def _fmt(chunk: bytes, order: str) -> tuple[int, int, int, Encoding | None] | None:
    if len(chunk) < 16:
        return None
    kind, channels, sample_rate, _, frame_bytes, bits = struct.unpack_from(f"{order}HHIIHH", chunk)
    if kind == EXTENSIBLE and len(chunk) >= 26:
        (kind,) = struct.unpack_from(f"{order}H", chunk, 24)
    packed = order == "<" and channels > 0 and frame_bytes * 8 == channels * bits
    return channels, sample_rate, frame_bytes, _ENCODINGS.get((kind, bits)) if packed else None


def _ds64(chunk: bytes, order: str) -> int:
    return int(struct.unpack(f"{order}QQ", chunk)[1]) if len(chunk) == 16 else 0
