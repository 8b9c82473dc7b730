"""The bounded buffer between the network and the localizer."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from neuralmusic.protocol.framing import NANOSECONDS


class Piece(NamedTuple):
    """Consecutive sample frames as they arrived."""

    position: int
    """Sample frames from the session's start to the piece's first, dropped and missing included"""
    data: bytes
    """Interleaved samples"""
    arrived: float
    """Time in seconds at which the last byte arrived"""
    capture_time_ns: int | None = None
    """Capture time of the first sample frame"""


class AudioBuffer:
    """A queue of audio; any number of sample frames can be taken or dropped at its front.

    Parameters
    ----------
    frame_bytes : int
        Bytes of one sample frame, all channels.
    sample_rate : int
        Hertz.
    """

    def __init__(self, frame_bytes: int, sample_rate: int) -> None:
        self._frame_bytes = frame_bytes
        self._sample_rate = sample_rate
        self._pieces: deque[Piece] = deque()
        self.frames = 0
        """Sample frames in the buffer"""

    def append(self, piece: Piece) -> None:
        """Add whole sample frames at the end."""
        if piece.data:
            self._pieces.append(piece)
            self.frames += len(piece.data) // self._frame_bytes

    def take(self, frames: int) -> list[Piece]:
        """Remove the oldest ``frames`` sample frames, or all where there are fewer."""
        taken: list[Piece] = []
        while frames > 0 and self._pieces:
            piece = self._pieces.popleft()
            held = len(piece.data) // self._frame_bytes
            if held > frames:
                self._pieces.appendleft(self._rest(piece, frames))
                data = piece.data[: frames * self._frame_bytes]
                piece, held = (
                    Piece(piece.position, data, piece.arrived, piece.capture_time_ns),
                    frames,
                )
            taken.append(piece)
            frames -= held
            self.frames -= held
        return taken

    def keep(self, frames: int) -> int:
        """Drop the oldest audio until ``frames`` sample frames are left; return how many went."""
        dropped = max(0, self.frames - frames)
        self.take(dropped)
        return dropped

    def _rest(self, piece: Piece, frames: int) -> Piece:
        """``piece`` without its first ``frames`` sample frames."""
        captured = piece.capture_time_ns
        if captured is not None:
            captured += frames * NANOSECONDS // self._sample_rate
        data = piece.data[frames * self._frame_bytes :]
        return Piece(piece.position + frames, data, piece.arrived, captured)
