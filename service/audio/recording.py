"""Recordings: a header checked against limits, then audio decoded and resampled block by block.

Anything that libsndfile reads is accepted. No allocation trusts a header, and memory is bounded
by one block, whatever the length of the recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from io import SEEK_CUR, SEEK_END, SEEK_SET
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
import soundfile
import soxr

from neuralmusic.errors import (
    AudioTooLong,
    EmptyAudio,
    NonFiniteAudio,
    NotAudio,
    TooManyChannels,
    TruncatedAudio,
    UnsupportedSampleRate,
)
from neuralmusic.wav import LEAST_UNKNOWN, WavHeader, is_wav, read_wav_header
from service.audio.containers import HEAD_BYTES, promised_bytes
from service.doa.types import FloatArray

BLOCK_SECONDS = 2
MAX_BLOCK_SAMPLES = 4 * 2**20
"""Most samples in a block, all channels together: 16 MiB of float32"""

MAX_AMPLITUDE = 1e7
"""Largest usable sample: above 24-bit integers kept as floats, and its fourth power fits float32"""

INT16_STEP = np.float32(2**-15)
"""One step of 16-bit audio; full scale is 1"""

UNKNOWN_FRAMES = 2**62
"""Frames that mean an unknown length: libsndfile gives 2^63 - 1 where a header does not say"""


@dataclass(frozen=True, slots=True)
class AudioLimits:
    """Largest and smallest values that a recording's header may claim."""

    max_channels: int = 64
    max_seconds: float = 3600.0
    min_sample_rate: int = 4_000
    """Hertz"""
    max_sample_rate: int = 384_000
    """Hertz"""


class Recording:
    """A multichannel recording whose header has been checked; samples are decoded on demand."""

    def __init__(
        self, sound: soundfile.SoundFile, closing: ExitStack, *, open_ended: bool = False
    ) -> None:
        self._sound = sound
        self.open_ended = open_ended
        """Whether the header does not say how long the recording is, and the file's end does"""
        self._closing = closing
        self.sample_rate = int(sound.samplerate)
        self.channels = int(sound.channels)
        self.num_frames = int(sound.frames)

    @classmethod
    def open(cls, file: BinaryIO | Path, limits: AudioLimits | None = None) -> Self:
        """Read the header of a seekable file and check it.

        Raises
        ------
        NotAudio
            If libsndfile does not know the format.
        EmptyAudio, TruncatedAudio
            If there is no audio, or less than a WAV header promises.
        TooManyChannels, UnsupportedSampleRate, AudioTooLong
            If the header exceeds the limits.
        """
        limits = limits or AudioLimits()
        with ExitStack() as stack:
            source = stack.enter_context(file.open("rb")) if isinstance(file, Path) else file
            header = _check_header(source, limits)
            source.seek(0)
            read = _Source(source) if header is None or header.plain else _Rewritten(source, header)
            sound = stack.enter_context(_open_sound(read))
            _check_format(sound.channels, sound.samplerate, limits)
            _check_length(sound.frames, sound.samplerate, limits)
            open_ended = header is not None and header.open_ended
            return cls(sound, stack.pop_all(), open_ended=open_ended)

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return self.num_frames / self.sample_rate

    def blocks(self, channels: Sequence[int], sample_rate: int) -> Iterator[FloatArray]:
        """Decode from the start, block by block.

        All channels pass through one resampler, so the delays between them stay as they are.

        Parameters
        ----------
        channels : sequence of int
            Recording channels to take, from 0, in the order wanted.
        sample_rate : int
            Hertz wanted.

        Yields
        ------
        block : (N, T) float32
            About two seconds; together the whole recording.

        Raises
        ------
        TruncatedAudio
            If decoding ends before the length that the header promises.
        NonFiniteAudio
            If a sample of these channels is NaN, infinite or absurdly large.
        """
        resampler = None
        if sample_rate != self.sample_rate:
            resampler = soxr.ResampleStream(
                self.sample_rate, sample_rate, len(channels), dtype="float32", quality="HQ"
            )
        start = 0
        all_in_order = list(channels) == list(range(self.channels))
        for decoded in self._decode():
            block = decoded
            if not all_in_order:
                block = np.ascontiguousarray(decoded[:, list(channels)])
            self._check_samples(block, channels, start)
            start += len(block)
            if resampler is not None:
                block = resampler.resample_chunk(block, last=start == self.num_frames)
            if len(block):
                yield np.ascontiguousarray(block.T)

    def close(self) -> None:
        """Close the decoder, and the file where a path was given."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _decode(self) -> Iterator[FloatArray]:
        """Blocks (T, channels) float32 that add up to exactly ``num_frames``."""
        # libsndfile converts 16 bits to the same floats, but takes five times as long as numpy.
        has_16_bits = self._sound.subtype == "PCM_16"
        dtype = "int16" if has_16_bits else "float32"
        length = min(BLOCK_SECONDS * self.sample_rate, MAX_BLOCK_SAMPLES // self.channels)
        done = 0
        while done < self.num_frames:
            wanted = min(length, self.num_frames - done)
            try:
                if done == 0:
                    self._sound.seek(0)
                block = self._sound.read(wanted, dtype=dtype, always_2d=True)
            except soundfile.SoundFileError:
                block = np.empty((0, self.channels), np.float32)
            if len(block) < wanted:
                raise TruncatedAudio(
                    f"the header promises {self.duration:.2f} s of audio, but the file cannot be "
                    f"decoded beyond {(done + len(block)) / self.sample_rate:.2f} s: "
                    "send the whole, undamaged file"
                )
            done += wanted
            yield block * INT16_STEP if has_16_bits else block

    def _check_samples(self, block: FloatArray, channels: Sequence[int], start: int) -> None:
        usable = np.abs(block) <= MAX_AMPLITUDE  # False for NaN, too
        if usable.all():
            return
        frame, column = np.argwhere(~usable)[0]
        raise NonFiniteAudio(
            f"channel {channels[column]} is {block[frame, column]:g} at "
            f"{(start + frame) / self.sample_rate:.3f} s: repair the recording, or record integer "
            "samples"
        )


class _Source:
    """A seekable file behind libsndfile's callbacks, where an exception would only be printed."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        file.seek(0, SEEK_END)
        self._size = file.tell()
        file.seek(0)

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        # Damaged headers make libsndfile seek to negative and to absurd places.
        base = {SEEK_SET: 0, SEEK_CUR: self._file.tell(), SEEK_END: self._size}[whence]
        return self._file.seek(min(max(base + offset, 0), self._size))

    def tell(self) -> int:
        return self._file.tell()

    def read(self, count: int = -1) -> bytes:
        return self._file.read(count)


class _Rewritten(_Source):
    """A WAV file whose header libsndfile cannot read, behind one that it can."""

    def __init__(self, file: BinaryIO, header: WavHeader) -> None:
        super().__init__(file)
        self._head = header.rewritten
        self._start = header.start
        self._size = len(self._head) + header.held
        self._place = 0

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        base = {SEEK_SET: 0, SEEK_CUR: self._place, SEEK_END: self._size}[whence]
        self._place = min(max(base + offset, 0), self._size)
        return self._place

    def tell(self) -> int:
        return self._place

    def read(self, count: int = -1) -> bytes:
        count = self._size - self._place if count < 0 else count
        head = self._head[self._place : self._place + count]
        self._file.seek(self._start + max(self._place - len(self._head), 0))
        data = head + self._file.read(count - len(head))
        self._place += len(data)
        return data


def _open_sound(source: _Source) -> soundfile.SoundFile:
    try:
        # soundfile gets no file name: it would take x.raw for headerless samples.
        return soundfile.SoundFile(source, "r")
    except (soundfile.SoundFileError, TypeError, ValueError) as error:
        raise NotAudio(
            "the bytes are no audio file that can be read: send WAV, FLAC or another format that "
            "libsndfile knows, with its header"
        ) from error


def _check_header(source: BinaryIO, limits: AudioLimits) -> WavHeader | None:
    """The header of a WAV file; None for another format."""
    source.seek(0)
    start = source.read(HEAD_BYTES)
    if not is_wav(start):
        _check_size(source, promised_bytes(start))
        return None
    header = read_wav_header(source)
    if header is None:
        raise TruncatedAudio("the WAV file ends before its audio begins: send the whole file")
    if header.channels:  # zero is for libsndfile to refuse
        _check_format(header.channels, header.sample_rate, limits)
    if header.truncated:
        raise TruncatedAudio(_truncation(header))
    if header.ambisonic:
        raise NotAudio(
            "the channels are ambisonic (B-format), sums of microphones that hold no delays: send "
            "the microphones' own channels, A-format, with the microphones' positions"
        )
    if header.promised == 0 and header.held > 0 and not header.open_ended:
        raise EmptyAudio(
            "the WAV header says that there is no audio: the recorder did not finish the file; "
            "stop it properly, or convert the file again"
        )
    return header


def _check_size(source: BinaryIO, promised: int) -> None:
    held = source.seek(0, SEEK_END)
    if promised > held:
        raise TruncatedAudio(
            f"the header promises a file of {promised} bytes, but it has {held}: send the whole "
            "file"
        )


def _truncation(header: WavHeader) -> str:
    remedy = "send the whole file"
    if header.promised >= LEAST_UNKNOWN:
        remedy = (
            "a recorder that writes into a pipe does not know the length; record into a file, or "
            "for a fixed duration"
        )
    return (
        f"the WAV header promises {header.promised} bytes of audio, but the file holds "
        f"{header.held}: {remedy}"
    )


def _check_format(channels: int, sample_rate: int, limits: AudioLimits) -> None:
    if channels > limits.max_channels:
        raise TooManyChannels(
            f"the recording has {channels} channels, at most {limits.max_channels} are accepted: "
            "send only the array's channels"
        )
    if not limits.min_sample_rate <= sample_rate <= limits.max_sample_rate:
        raise UnsupportedSampleRate(
            f"the sample rate is {sample_rate} Hz, accepted are {limits.min_sample_rate} to "
            f"{limits.max_sample_rate} Hz: check the header, or resample the recording"
        )


def _check_length(frames: int, sample_rate: int, limits: AudioLimits) -> None:
    if frames <= 0:
        raise EmptyAudio("the recording holds no samples: check that the recorder wrote any")
    if frames >= UNKNOWN_FRAMES:
        raise TruncatedAudio(
            "the header does not say how long the recording is: record into a file, not a pipe"
        )
    if frames > limits.max_seconds * sample_rate:
        raise AudioTooLong(
            f"the recording lasts {frames / sample_rate:.0f} s by its header, at most "
            f"{limits.max_seconds:g} s are accepted: split it"
        )
