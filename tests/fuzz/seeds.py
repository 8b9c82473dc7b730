"""Short recordings in every format that the service may be sent, to be damaged."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from functools import cache

import numpy as np
import soundfile

SECONDS = 0.3
SQUARE = "respeaker-usb-4mic-v2"
PAIR = '{"positions_m":[[0.05,0,0],[-0.05,0,0]]}'

FORMATS: tuple[tuple[str, str, int, int], ...] = (
    ("WAV", "PCM_16", 4, 16_000),
    ("WAV", "PCM_16", 4, 48_000),
    ("WAV", "PCM_24", 4, 16_000),
    ("WAV", "PCM_32", 4, 16_000),
    ("WAV", "PCM_U8", 4, 8_000),
    ("WAV", "FLOAT", 4, 16_000),
    ("WAV", "DOUBLE", 4, 16_000),
    ("WAV", "ULAW", 4, 16_000),
    ("WAV", "IMA_ADPCM", 2, 16_000),
    ("WAV", "MS_ADPCM", 2, 16_000),
    ("WAV", "GSM610", 1, 8_000),
    ("WAVEX", "PCM_16", 4, 16_000),
    ("WAVEX", "FLOAT", 4, 16_000),
    ("RF64", "PCM_16", 4, 16_000),
    ("FLAC", "PCM_16", 4, 16_000),
    ("FLAC", "PCM_24", 4, 48_000),
    ("OGG", "VORBIS", 4, 16_000),
    ("OGG", "OPUS", 4, 48_000),
    ("MP3", "MPEG_LAYER_III", 2, 16_000),
    ("AIFF", "PCM_16", 4, 16_000),
    ("AIFF", "FLOAT", 4, 16_000),
    ("AIFF", "IMA_ADPCM", 2, 16_000),
    ("AU", "PCM_16", 4, 16_000),
    ("AU", "ULAW", 4, 8_000),
    ("CAF", "PCM_16", 4, 16_000),
    ("CAF", "ALAC_16", 4, 16_000),
    ("CAF", "ALAC_32", 4, 16_000),
    ("W64", "PCM_16", 4, 16_000),
    ("W64", "IMA_ADPCM", 2, 16_000),
    ("W64", "MS_ADPCM", 2, 16_000),
    ("AVR", "PCM_16", 2, 16_000),
    ("HTK", "PCM_16", 1, 16_000),
    ("IRCAM", "PCM_16", 4, 16_000),
    ("MAT4", "FLOAT", 4, 16_000),
    ("MAT5", "PCM_16", 4, 16_000),
    ("MPC2K", "PCM_16", 2, 16_000),
    ("NIST", "PCM_16", 4, 16_000),
    ("PAF", "PCM_24", 4, 16_000),
    ("PVF", "PCM_16", 4, 16_000),
    ("SDS", "PCM_16", 1, 16_000),
    ("SVX", "PCM_16", 1, 16_000),
    ("VOC", "PCM_16", 2, 16_000),
    ("WVE", "ALAW", 1, 8_000),
    ("XI", "DPCM_16", 1, 16_000),
)
"""Format, subtype, channels and hertz of all files that libsndfile tells by their first bytes"""
USUAL = ("WAV", "WAVEX", "RIFX", "RF64", "BW64", "FLAC", "OGG", "AIFF", "AU", "CAF", "W64")
"""Formats that robots send; they are damaged twice as often"""


@dataclass(frozen=True, slots=True)
class Seed:
    """An undamaged recording."""

    kind: str
    content: bytes
    channels: int

    @property
    def array(self) -> str:
        """The ``array`` that fits it; with one channel none does."""
        return PAIR if self.channels == 2 else SQUARE


@cache
def seeds() -> tuple[Seed, ...]:
    """All of them, in an order that never changes."""
    found = [
        Seed(kind, encoded(kind, subtype, channels, rate), channels)
        for kind, subtype, channels, rate in FORMATS
    ]
    wav, rf64 = found[0].content, encoded("RF64", "PCM_16", 4, 16_000)
    found += [
        Seed("RIFX", encoded("WAV", "PCM_16", 4, 16_000, endian="BIG"), 4),
        Seed("BW64", b"BW64" + rf64[4:], 4),
        Seed("WAV", with_chunks(wav), 4),
        Seed("WAV", in_a_pipe(wav), 4),
        Seed("RAW", samples(4, 16_000).astype("<f4").tobytes(), 4),
        Seed("RAW", np.round(samples(4, 16_000) * 32767).astype("<i2").tobytes(), 4),
    ]
    return tuple(found + [seed for seed in found if seed.kind in USUAL])


def samples(channels: int, rate: int) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Noise (T, channels), a little different in every channel."""
    random = np.random.default_rng(channels)
    count = round(SECONDS * rate)
    common = random.standard_normal((count, 1))
    return (0.05 * (common + 0.3 * random.standard_normal((count, channels)))).astype(np.float32)


def encoded(kind: str, subtype: str, channels: int, rate: int, endian: str = "FILE") -> bytes:
    """A file of ``SECONDS``."""
    file = io.BytesIO()
    soundfile.write(
        file, samples(channels, rate), rate, format=kind, subtype=subtype, endian=endian
    )
    return file.getvalue()


def with_chunks(wav: bytes) -> bytes:
    """A WAV file with chunks of even and odd lengths before and after its audio."""
    before = b"".join(
        name + struct.pack("<I", len(body)) + body + bytes(len(body) % 2)
        for name, body in (
            (b"bext", bytes(602)),
            (b"LIST", b"INFOISFT\x05\x00\x00\x00abcd\x00\x00"),
            (b"JUNK", b"odd"),
            (b"cue ", struct.pack("<I", 1) + bytes(24)),
            (b"fact", struct.pack("<I", 4800)),
        )
    )
    content = wav[:36] + before + wav[36:] + b"id3 \x0a\x00\x00\x00ID3\x04\x00\x00\x00\x00\x00\x00"
    return content[:4] + struct.pack("<I", len(content) - 8) + content[8:]


def in_a_pipe(wav: bytes) -> bytes:
    """A WAV file as arecord writes it into a pipe."""
    length = struct.pack("<I", 0x7FFF_FF00)
    return wav[:4] + length + wav[8:40] + length + wav[44:]
