"""A stream worker's process, with more work than it can take."""

from __future__ import annotations

import asyncio
import os
import signal

from scripted_service import TIMEOUT_S

from service.api.stream_workers import StreamWorker
from service.metrics import Metrics
from service.protocol.client_messages import ArrayChoice, AudioFormat, Start
from service.settings import Settings
from service.startup import load_registry
from service.streaming.work import Open, Outcome
from service.worker_link import Setup

MANY = 4000
"""Whose messages and answers fill the sockets in both directions"""


def test_a_worker_that_is_behind_ends_when_it_is_asked_to() -> None:
    """It waits until its answers are read, so nobody may wait until it has read all."""
    start = Start(
        type="start",
        audio=AudioFormat(encoding="pcm_s16le", sample_rate=16_000, channels=4),
        array=ArrayChoice(name="respeaker-usb-4mic-v2"),
    )
    settings = Settings()
    setup = Setup(settings, load_registry(settings).files)
    answered: list[Outcome] = []

    async def scenario() -> None:
        worker = StreamWorker(setup, Metrics())
        worker.start()
        await worker.ready.wait()
        for number in range(MANY):
            worker.submit(Open(f"session-{number}", start, None), answered.append)
        assert worker.pid is not None
        try:
            async with asyncio.timeout(TIMEOUT_S):
                await worker.stop()
        except TimeoutError:
            os.kill(worker.pid, signal.SIGKILL)  # or nothing would ever end
            raise

    asyncio.run(scenario())
    assert len(answered) < MANY
