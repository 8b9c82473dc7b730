"""Seconds of a core that streams cost a second: what ``service/streaming/cost.py`` estimates.

Run with one BLAS thread (``OPENBLAS_NUM_THREADS=1``); a row takes some seconds.
"""

from __future__ import annotations

import time

import numpy as np

from neuralmusic.protocol.client_messages import Start
from service.inference.registry import BundleRegistry
from service.streaming.buffer import Piece
from service.streaming.cost import stream_cost
from service.streaming.opening import open_stream
from service.streaming.work import Open

SECONDS = 4
STREAMS = (
    # microphones, channels, hertz, method, milliseconds
    (4, 4, 16_000, "neural", 100),
    (4, 4, 48_000, "neural", 100),
    (4, 4, 16_000, "neural", 20),
    (4, 4, 16_000, "neural", 1000),
    (8, 8, 16_000, "neural", 100),
    (16, 16, 16_000, "neural", 100),
    (32, 32, 16_000, "neural", 100),
    (64, 64, 16_000, "neural", 200),
    (4, 4, 16_000, "music", 100),
    (16, 16, 16_000, "music", 100),
    (32, 32, 16_000, "music", 1000),
    (4, 4, 384_000, "music", 1000),
    (32, 64, 384_000, "music", 1000),
)


def measured(start: Start, registry: BundleRegistry) -> float:
    """CPU seconds a second of one stream of noise."""
    pipeline, _ = open_stream(Open("costs", start), registry)
    audio, interval_ms = start.audio, start.output.interval_ms
    frames = round(audio.sample_rate * interval_ms / 1000)
    noise = 0.05 * np.random.default_rng(0).standard_normal((frames, audio.channels))
    data, position = noise.astype("<f4").tobytes(), 0

    def steps(seconds: int) -> None:
        nonlocal position
        for _ in range(max(1, seconds * 1000 // interval_ms)):
            pipeline.step([Piece(position, data, 0.0, None)], start.output)
            position += frames

    steps(1)
    begin = time.process_time()
    steps(SECONDS)
    return (time.process_time() - begin) / SECONDS


def main() -> None:
    registry = BundleRegistry.load()
    print("microphones channels  hertz method   ms  measured estimated")
    for microphones, channels, sample_rate, method, interval_ms in STREAMS:
        angles = 2 * np.pi * np.arange(microphones) / microphones
        ring = [(0.1 * float(np.cos(a)), 0.1 * float(np.sin(a)), 0.0) for a in angles]
        start = Start.model_validate(
            {
                "type": "start",
                "method": method,
                "audio": {
                    "encoding": "pcm_f32le",
                    "sample_rate": sample_rate,
                    "channels": channels,
                },
                "array": {"positions_m": ring},
                "channel_map": list(range(microphones)),
                "output": {"interval_ms": interval_ms},
            }
        )
        estimate = stream_cost(start, interval_ms).share
        print(
            f"{microphones:11d} {channels:8d} {sample_rate:6d} {method:6} {interval_ms:4d} "
            f"{measured(start, registry):9.3f} {estimate:9.3f}"
        )


if __name__ == "__main__":
    main()
