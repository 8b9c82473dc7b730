"""PCM bytes to samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralmusic.protocol.framing import Encoding
from service.audio.recording import MAX_AMPLITUDE
from service.doa.types import FloatArray

CONTAINERS = {b"RIFF": "WAV", b"RF64": "WAV", b"fLaC": "FLAC", b"OggS": "Ogg", b"FORM": "AIFF"}


def decode_pcm(
    data: bytes, encoding: Encoding, channels: int, channel_map: Sequence[int]
) -> FloatArray:
    """Samples (N, T) float32 of the mapped channels, full scale 1.

    Non-finite and absurdly large floats come out as NaN, for the diagnostics to count.
    """
    if encoding == "pcm_s24le":
        wide = np.zeros((len(data) // 3, 4), dtype=np.uint8)
        wide[:, 1:] = np.frombuffer(data, dtype=np.uint8).reshape(-1, 3)
        integers, scale = wide.reshape(-1).view("<i4"), 2.0**-31
    elif encoding == "pcm_f32le":
        floats = np.frombuffer(data, dtype="<f4").reshape(-1, channels)[:, channel_map].T
        usable = np.abs(floats) <= MAX_AMPLITUDE
        return np.where(usable, floats, np.float32(np.nan))
    else:
        integers = np.frombuffer(data, dtype="<i2" if encoding == "pcm_s16le" else "<i4")
        scale = 2.0**-15 if encoding == "pcm_s16le" else 2.0**-31
    # 32-bit integers times a float32 would be float64, which the resampler does not take.
    chosen = integers.reshape(-1, channels)[:, channel_map].T.astype(np.float32)
    samples: FloatArray = chosen * np.float32(scale)
    return samples


def container_of(data: bytes) -> str | None:
    """The audio file format whose header ``data`` begins with, or None."""
    return CONTAINERS.get(bytes(data[:4]))
