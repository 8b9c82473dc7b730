"""Recordings as sources: WAV files as they are, others through soundfile."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from neuralmusic.errors import ConfigError, NotAudio, TruncatedAudio
from neuralmusic.protocol.framing import SAMPLE_BYTES, Encoding
from neuralmusic.sources.source import CHUNK_S, Send, paced
from neuralmusic.wav import WavHeader, read_wav_header

BLOCK_S = 1.0
"""Seconds of audio read at a time, unless in real time"""


class Frames(Protocol):
    """Sample frames of a file, in order."""

    encoding: Encoding
    sample_rate: int
    """Hertz"""
    channels: int

    def read(self, count: int) -> bytes:
        """The next sample frames, at most ``count``; empty at the end."""

    def close(self) -> None: ...


class FileSource:
    """A recording, sent as fast as the service takes it or in real time.

    Parameters
    ----------
    path : Path
    realtime : bool
        Send the recording at the pace at which it was recorded.

    Raises
    ------
    NotAudio, TruncatedAudio
        If the file is not audio, or shorter than its header says.
    ConfigError
        If the file needs soundfile, which is not installed.
    OSError
        If the file cannot be read.
    """

    def __init__(self, path: Path, *, realtime: bool) -> None:
        self._frames = _open(path)
        self.live = realtime
        self.audio: dict[str, Any] = {
            "encoding": self._frames.encoding,
            "sample_rate": self._frames.sample_rate,
            "channels": self._frames.channels,
            "header": "seq_time" if realtime else "none",
        }

    def feed(self, send: Send, stopping: threading.Event) -> None:
        """Send everything, or until ``stopping`` is set."""
        frames, chunks = self._frames, self._chunks()
        if self.live:
            frame_bytes = SAMPLE_BYTES[frames.encoding] * frames.channels
            chunks = paced(chunks, frames.sample_rate * frame_bytes, stopping.wait)
        for chunk in chunks:
            if stopping.is_set():
                return
            send(chunk)

    def close(self) -> None:
        """Close the file."""
        self._frames.close()

    def _chunks(self) -> Iterator[bytes]:
        seconds = CHUNK_S if self.live else BLOCK_S
        count = max(int(seconds * self._frames.sample_rate), 1)
        while True:
            chunk = self._frames.read(count)
            if not chunk:
                return
            yield chunk


def _open(path: Path) -> Frames:
    with path.open("rb") as file:
        header = read_wav_header(file)
    if header is None or header.encoding is None:
        return DecodedFrames(path)
    if header.truncated:
        raise TruncatedAudio(
            f"{path}: the header promises {header.promised} bytes of audio, but the file holds "
            f"{header.held}: copy it again"
        )
    return WavFrames(path, header, header.encoding)


class WavFrames:
    """The samples of a WAV file as they are stored."""

    def __init__(self, path: Path, header: WavHeader, encoding: Encoding) -> None:
        self.encoding, self.sample_rate = encoding, header.sample_rate
        self.channels, self._frame_bytes = header.channels, header.frame_bytes
        length = header.held if header.open_ended else min(header.promised, header.held)
        self._left = length // header.frame_bytes
        self._file = path.open("rb")
        self._file.seek(header.start)

    def read(self, count: int) -> bytes:
        count = min(count, self._left)
        self._left -= count
        return self._file.read(count * self._frame_bytes)

    def close(self) -> None:
        self._file.close()


class DecodedFrames:
    """The samples of any file that libsndfile reads, as float32."""

    encoding: Encoding = "pcm_f32le"

    def __init__(self, path: Path) -> None:
        try:
            import soundfile
        except ImportError:
            raise ConfigError(
                f"{path}: only WAV files of 16, 24 or 32 bits are read without soundfile: "
                "pip install './client[files]' in the project's folder for FLAC and others"
            ) from None
        try:
            self._file = soundfile.SoundFile(path)
        except soundfile.LibsndfileError as error:
            raise NotAudio(f"{path} is not an audio file that can be read ({error})") from None
        self.sample_rate, self.channels = self._file.samplerate, self._file.channels

    def read(self, count: int) -> bytes:
        return bytes(self._file.buffer_read(count, dtype="float32"))

    def close(self) -> None:
        self._file.close()
