"""From binary messages to the buffer: whole sample frames, sequence numbers, the size limit."""

from __future__ import annotations

from dataclasses import dataclass

from neuralmusic.errors import InvalidMessage, MessageTooBig
from neuralmusic.protocol import MAX_MESSAGE_BYTES
from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.framing import HEADER, NANOSECONDS, SEQUENCE_MODULUS, FrameHeader
from service.audio.pcm import container_of
from service.streaming.buffer import AudioBuffer, Piece

LONGEST_GAP = 3600.0
"""Longest gap in seconds; a longer one by the capture times means that the clock was set"""


@dataclass(frozen=True, slots=True)
class Gap:
    """Missing messages, by the sequence numbers."""

    messages: int
    frames: int
    """Missing sample frames by the capture times; 0 where these do not tell"""


class Intake:
    """Puts the binary messages of one stream into its buffer."""

    def __init__(self, audio: AudioFormat) -> None:
        self._audio = audio
        self._header: FrameHeader | None = None
        self._first = True
        self.buffer = AudioBuffer(audio.frame_bytes, audio.sample_rate)
        self.position = 0
        """Sample frames up to the end of the received audio, missing ones included"""
        self.received = 0
        """Sample frames received"""
        self._expected_ns = 0

    @property
    def removed(self) -> int:
        """Sample frames taken or dropped."""
        return self.received - self.buffer.frames

    def time_of(self, captured_ns: int) -> float | None:
        """Seconds of the stream at a capture time; None before the first one was received."""
        if self._header is None:
            return None
        later = (captured_ns - self._expected_ns) / NANOSECONDS
        return self.position / self._audio.sample_rate + later

    def receive(self, message: bytes, now: float) -> Gap | None:
        """Buffer one message's audio; return the gap before it, if there is one.

        Raises
        ------
        InvalidMessage, MessageTooBig
            If the message is a file's header, too long, or not a whole number of sample frames.
        """
        if len(message) > MAX_MESSAGE_BYTES:
            raise MessageTooBig(
                f"a binary message has {len(message)} bytes, at most {MAX_MESSAGE_BYTES} are "
                "accepted: send smaller pieces more often"
            )
        gap, captured = None, None
        audio = message
        if self._audio.header == "seq_time":
            gap, captured = self._unpack(message)
            audio = message[HEADER.size :]
        self._check(audio)
        frames = len(audio) // self._audio.frame_bytes
        if gap is not None:
            self.position += gap.frames
        if captured is not None:
            self._expected_ns = captured + frames * NANOSECONDS // self._audio.sample_rate
        self.buffer.append(Piece(self.position, audio, now, captured))
        self.position += frames
        self.received += frames
        return gap

    def _check(self, audio: bytes) -> None:
        if self._first and audio:
            self._first = False
            container = container_of(audio)
            if container:
                raise InvalidMessage(
                    f"the first audio begins with the header of a {container} file: send the raw "
                    "samples behind the header, or send the file to POST /localize"
                )
        size, channels = self._audio.frame_bytes, self._audio.channels
        if len(audio) % size:
            raise InvalidMessage(
                f"a binary message holds {len(audio)} bytes of audio, which is no whole number of "
                f"sample frames of {size} bytes ({channels} channels of {self._audio.encoding}): "
                "check channels and encoding, never split a sample frame"
            )

    def _unpack(self, message: bytes) -> tuple[Gap | None, int]:
        if len(message) < HEADER.size:
            raise InvalidMessage(
                f"a binary message has {len(message)} bytes, but with header seq_time each begins "
                f"with {HEADER.size}: u32 flags, u32 sequence, i64 capture time in ns"
            )
        header, before = FrameHeader.unpack(message), self._header
        self._header = header
        if before is None:
            return None, header.capture_time_ns
        missed = (header.sequence - before.sequence - 1) % SEQUENCE_MODULUS
        if missed == 0:
            return None, header.capture_time_ns
        if missed >= SEQUENCE_MODULUS // 2:  # the sender restarted: the loss cannot be told
            return Gap(0, 0), header.capture_time_ns
        seconds = (header.capture_time_ns - self._expected_ns) / NANOSECONDS
        frames = round(seconds * self._audio.sample_rate) if 0 < seconds <= LONGEST_GAP else 0
        return Gap(missed, frames), header.capture_time_ns
