"""Raw samples on standard input, from a recorder's pipe."""

from __future__ import annotations

import os
import select
import sys
import threading
from typing import Any

from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.framing import Encoding
from neuralmusic.sources.source import CHUNK_S, Send


class StandardInput:
    """Interleaved samples without any header; live, since a recorder does not wait.

    Parameters
    ----------
    encoding : str
        An encoding of ``AudioFormat``.
    sample_rate : int
        Hertz.
    channels : int
    """

    live = True

    def __init__(self, encoding: Encoding, sample_rate: int, channels: int) -> None:
        self.audio: dict[str, Any] = {
            "encoding": encoding,
            "sample_rate": sample_rate,
            "channels": channels,
            "header": "seq_time",
        }
        self._frame_bytes = AudioFormat.model_validate(self.audio).frame_bytes
        self._most = max(int(CHUNK_S * sample_rate), 1) * self._frame_bytes

    def feed(self, send: Send, stopping: threading.Event) -> None:
        """Send samples until the pipe ends or ``stopping`` is set."""
        pipe, held = sys.stdin.buffer.fileno(), b""
        while not stopping.is_set():
            if not select.select([pipe], [], [], CHUNK_S)[0]:
                continue  # nothing yet: check whether to stop
            read = os.read(pipe, self._most)
            if not read:
                return
            held += read
            whole = len(held) // self._frame_bytes * self._frame_bytes
            if whole:
                send(held[:whole])
                held = held[whole:]

    def close(self) -> None:
        """Leave standard input open: it belongs to the program."""
