"""Audio from any buffer (bytes, numpy arrays, audio callbacks) as messages of whole sample frames.

numpy is never imported: an array tells its type and shape through the buffer protocol.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from neuralmusic.errors import AudioError, ChannelMismatch
from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.framing import HEADER, NANOSECONDS, SAMPLE_BYTES, Encoding

MESSAGE_SECONDS = 0.1
"""Most seconds of audio in one message; audio is dropped in such pieces"""
MESSAGE_BYTES = 64 * 1024
"""Most bytes of one message: small enough for every version of the service"""

_TYPES: dict[Encoding, tuple[str, str]] = {
    "pcm_s16le": ("h", "int16"),
    "pcm_s24le": ("", "packed bytes"),
    "pcm_s32le": ("il", "int32"),
    "pcm_f32le": ("f", "float32"),
}
"""Type codes of the buffer protocol and numpy's name for every encoding"""


def read_frames(audio: Any, audio_format: AudioFormat) -> memoryview:
    """Interleaved sample frames as bytes.

    Parameters
    ----------
    audio : bytes-like
        Bytes in the declared encoding, or an array (T, N) of it with the N declared channels; (T,)
        is allowed for one channel and for interleaved samples.

    Returns
    -------
    frames : memoryview
        Bytes, a whole number of sample frames.

    Raises
    ------
    AudioError
        If it is not a buffer, or has another sample type.
    ChannelMismatch
        If its shape or length does not fit the channels.
    """
    try:
        view = memoryview(audio)
    except TypeError:
        raise AudioError(
            f"{type(audio).__name__} is not audio: send bytes, or an array with the buffer "
            "protocol (numpy.asarray makes one)"
        ) from None
    _check_type(view, audio_format)
    channels = audio_format.channels
    if view.ndim > 1 and (view.ndim != 2 or view.shape is None or view.shape[1] != channels):
        raise ChannelMismatch(
            f"the array's shape is {view.shape}, but {channels} channels were declared: send "
            f"(samples, {channels}), one row per sample frame (transpose it where channels come "
            "first)"
        )
    flat = view.cast("B") if view.c_contiguous else memoryview(view.tobytes())
    size = audio_format.frame_bytes
    if len(flat) % size:
        raise ChannelMismatch(
            f"{len(flat)} bytes are no whole number of sample frames: {channels} channels of "
            f"{audio_format.encoding} are {size} bytes each"
        )
    return flat


def split_frames(
    frames: memoryview, audio_format: AudioFormat, capture_time_ns: int
) -> Iterator[tuple[memoryview, int]]:
    """Pieces that fit a message, each with its capture time in nanoseconds.

    Parameters
    ----------
    frames : memoryview
        Bytes of whole sample frames.
    capture_time_ns : int
        Capture time of the first sample frame.
    """
    size, rate = audio_format.frame_bytes, audio_format.sample_rate
    header = HEADER.size if audio_format.header == "seq_time" else 0
    most = min((MESSAGE_BYTES - header) // size, max(int(MESSAGE_SECONDS * rate), 1)) * size
    for start in range(0, len(frames), most):
        yield frames[start : start + most], capture_time_ns + start // size * NANOSECONDS // rate


def _check_type(view: memoryview, audio_format: AudioFormat) -> None:
    code = view.format.lstrip("@=<")
    if code in ("B", "b", "c"):
        return
    codes, name = _TYPES[audio_format.encoding]
    if len(code) != 1 or code not in codes or view.itemsize != SAMPLE_BYTES[audio_format.encoding]:
        raise AudioError(
            f"the samples are of the type {view.format!r} with {view.itemsize} bytes, but "
            f"{audio_format.encoding} was declared: send {name}, or declare what you send"
        )
