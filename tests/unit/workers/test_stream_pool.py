"""A stream worker's process, with more work than it can take."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest
from scripted_service import TIMEOUT_S

from neuralmusic.errors import WorkerLost
from neuralmusic.protocol.client_messages import ArrayChoice, AudioFormat, Start
from service.observability.metrics import Metrics
from service.settings import Settings
from service.startup import load_registry
from service.streaming.work import Failed, Open, Outcome
from service.workers import stream_pool
from service.workers.link import Setup
from service.workers.stream_pool import ENOUGH, StreamWorker, StreamWorkers

pytestmark = pytest.mark.processes

START = Start(
    type="start",
    audio=AudioFormat(encoding="pcm_s16le", sample_rate=16_000, channels=4),
    array=ArrayChoice(name="respeaker-usb-4mic-v2"),
)
MANY = 4000
"""Jobs whose messages and answers fill the sockets in both directions"""


def test_no_worker_keeps_the_models_that_a_reload_replaced() -> None:
    """Streams that come while the first new worker starts may start old ones; these are left."""
    settings = Settings()
    files = load_registry(settings).files
    before, after = Setup(settings, files), Setup(settings, files)

    async def scenario() -> None:
        workers = StreamWorkers(4, Metrics())
        workers.setup = before
        await workers.start()
        held = [workers.assign() for _ in range(ENOUGH)]
        reload = asyncio.create_task(workers.renew(after))
        await asyncio.sleep(0)  # it has started its worker and waits
        held += [workers.assign() for _ in range(ENOUGH + 1)]
        assert len({worker.pid for worker in held}) == 3
        async with asyncio.timeout(TIMEOUT_S):
            await reload
        assert all(worker.retired for worker in held)
        assert not workers.assign().retired
        await workers.stop()

    asyncio.run(scenario())


def test_whoever_waits_for_a_worker_that_never_comes_up_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stream_pool, "READY_S", 0.2)
    settings = Settings()
    setup = Setup(settings, load_registry(settings).files)
    answered: list[Outcome] = []

    async def scenario() -> None:
        workers = StreamWorkers(1, Metrics())
        workers.setup = setup
        async with asyncio.timeout(TIMEOUT_S):
            worker = workers.assign()
            stop(worker)
            worker.submit(Open("session", START, None), answered.append)
            assert not workers.ready
            await worker.ready.wait()
            assert worker.lost
            reload = asyncio.create_task(workers.renew(setup))
            await asyncio.sleep(0)  # it has started its worker and waits
            stop(workers._workers[-1])
            with pytest.raises(WorkerLost):
                await reload
            monkeypatch.undo()
            workers.tend()
            (kept,) = workers._current()
            await kept.ready.wait()
            assert workers.ready
            await workers.stop()

    asyncio.run(scenario())
    (failed,) = answered
    assert isinstance(failed, Failed)
    assert failed.error.code == "worker_lost"


def stop(worker: StreamWorker) -> None:
    """Let its process stand still."""
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGSTOP)


def test_a_worker_that_is_behind_ends_when_it_is_asked_to() -> None:
    """The worker waits until its answers are read, so nobody may wait until it has read all."""
    settings = Settings()
    setup = Setup(settings, load_registry(settings).files)
    answered: list[Outcome] = []

    async def scenario() -> None:
        worker = StreamWorker(setup, Metrics())
        worker.start()
        await worker.ready.wait()
        for number in range(MANY):
            worker.submit(Open(f"session-{number}", START, None), answered.append)
        assert worker.pid is not None
        try:
            async with asyncio.timeout(TIMEOUT_S):
                await worker.stop()
        except TimeoutError:
            os.kill(worker.pid, signal.SIGKILL)  # or nothing would ever end
            raise

    asyncio.run(scenario())
    assert len(answered) < MANY
