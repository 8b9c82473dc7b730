"""Turn towards the most confident active source.

Usage: python examples/robot_loop.py recording.wav respeaker-usb-4mic-v2 [http://robot:8000]

The recording stands in for a microphone: replace ``chunks`` by whatever records, and ``turn`` by
whatever moves. Needs ``pip install ./client soundfile``.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator

import soundfile

from neuralmusic import StreamClient
from neuralmusic.protocol.server_messages import Result

CHUNK_S = 0.05


def chunks(sound: soundfile.SoundFile) -> Iterator[object]:
    """Sample frames (T, N) as they would be recorded."""
    due = time.monotonic()
    for block in sound.blocks(int(CHUNK_S * sound.samplerate), dtype="int16", always_2d=True):
        due += CHUNK_S
        time.sleep(max(due - time.monotonic(), 0.0))
        yield block


def turn(azimuth_deg: float) -> None:
    """Towards degrees counter-clockwise from the front."""
    print(f"turn to {azimuth_deg:.0f} degrees")


def main(path: str, array: str, url: str = "http://127.0.0.1:8000") -> None:
    with soundfile.SoundFile(path) as sound:
        audio = {"encoding": "pcm_s16le", "sample_rate": sound.samplerate}
        audio["channels"] = sound.channels
        key = os.environ.get("NEURALMUSIC_KEY")  # where the service has keys
        with StreamClient(url, array=array, audio=audio, key=key) as stream:
            for chunk in chunks(sound):
                stream.send(chunk)
                results = [event for event in stream.received() if isinstance(event, Result)]
                active = [s for result in results[-1:] for s in result.sources if s.active]
                if active:
                    turn(max(active, key=lambda source: source.confidence).azimuth_deg)
            print(f"sources heard: {len(stream.stop().sources)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
