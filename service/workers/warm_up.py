"""A worker's first stream, whose results nobody waits for."""

from __future__ import annotations

import numpy as np

from neuralmusic.protocol.client_messages import ArrayChoice, AudioFormat, Start
from service.inference.registry import BundleRegistry
from service.streaming.buffer import Piece
from service.streaming.opening import open_stream
from service.streaming.work import Open


def warm_up(registry: BundleRegistry) -> None:
    """Run a stream of noise, so that the first robot need not wait for imports and caches."""
    start = Start(
        type="start",
        audio=AudioFormat(encoding="pcm_s16le", sample_rate=48_000, channels=4),
        array=ArrayChoice(name="respeaker-usb-4mic-v2"),
    )
    pipeline, opened = open_stream(Open("warm-up", start, None), registry)
    noise = np.random.default_rng(0).integers(-999, 999, (opened.clock.frames_needed(100), 4))
    piece = Piece(0, noise.astype("<i2").tobytes(), arrived=0.0)
    pipeline.step([piece], start.output, final=True)
