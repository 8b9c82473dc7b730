"""Processes for recordings that end while they are idle, and that never come up."""

from __future__ import annotations

import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import cast
from unittest.mock import Mock, patch

import pytest

from neuralmusic.errors import DecodingFailed, WorkerLost
from service.lifecycle import Lifecycle, Phase
from service.observability.metrics import Metrics
from service.recordings.job import RecordingJob
from service.settings import Settings
from service.startup import load_registry
from service.workers import recording_pool
from service.workers.link import Setup
from service.workers.recording_pool import RecordingWorker, RecordingWorkers

pytestmark = pytest.mark.processes


@pytest.fixture
def workers() -> Iterator[RecordingWorkers]:
    lifecycle = Lifecycle()
    pool = RecordingWorkers(1, 1, 60.0, Metrics(), lifecycle)
    settings = Settings()
    pool.setup = Setup(settings, load_registry(settings).files)
    yield pool
    lifecycle.enter(Phase.ENDING)
    pool.stop()


def test_an_idle_process_that_was_killed_is_replaced(workers: RecordingWorkers) -> None:
    assert workers.lacking
    workers.tend()
    (pid,) = workers.pids
    assert workers.ready
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    assert workers.lacking
    assert not workers.ready
    workers.tend()
    assert workers.pids != [pid]
    assert workers.ready
    assert not workers.lacking


@pytest.mark.parametrize("how", ["its deadline", "the service's end"])
def test_a_process_that_never_comes_up_holds_nobody(
    workers: RecordingWorkers, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_pool, "READY_S", 0.2 if how == "its deadline" else 60.0)
    assert workers.setup is not None
    setup, refused = workers.setup, []

    def prepare() -> None:
        try:
            workers.prepare(setup)
        except WorkerLost as error:
            refused.append(error)

    waiting = threading.Thread(target=prepare)
    waiting.start()
    while not (pids := workers.pids):
        pass
    os.kill(pids[0], signal.SIGSTOP)
    if how != "its deadline":
        workers.stop()
    waiting.join(30)
    assert len(refused) == 1
    assert workers.pids == []


def test_a_ready_process_that_is_stopped_is_lost_and_replaced(
    workers: RecordingWorkers, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The recording is not to blame, and its sender need not wait for as long as a decoder may."""
    monkeypatch.setattr(recording_pool, "TAKEN_S", 0.3)
    workers.tend()
    (pid,) = workers.pids
    os.kill(pid, signal.SIGSTOP)
    with (tmp_path / "audio").open("w+b") as file, pytest.raises(WorkerLost, match="try again"):
        workers._localize(cast(RecordingJob, None), file, Mock())
    assert workers.pids == []
    workers.tend()
    assert workers.ready


def test_a_recording_over_which_a_process_stalls_is_to_blame(workers: RecordingWorkers) -> None:
    assert workers.setup is not None
    worker = RecordingWorker(workers.setup, 1.0)
    worker.wait_ready()
    pieces = iter(["taken"])

    def receive() -> str:
        message = next(pieces, None)
        if message is None:
            raise TimeoutError("timed out")
        return message

    with (
        patch.object(worker, "_link", Mock(receive=receive)),
        tempfile.TemporaryFile() as file,
        pytest.raises(DecodingFailed, match="no progress for 1 s"),
    ):
        worker.localize(cast(RecordingJob, None), file, Mock())
    assert not worker.alive
