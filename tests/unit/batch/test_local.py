"""The engine of this machine: processes that may die."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neuralmusic.errors import WorkerLost
from service.batch.archive import FoundRecording, find_recordings
from service.batch.local import localize_here
from service.batch.plan import Plan

pytestmark = pytest.mark.processes

LONG_S = 20.0
"""Seconds of audio: part of it is done long before the rest"""


def children() -> list[int]:
    """The processes that this one's threads started and that still run."""
    tasks = Path("/proc/self/task").glob("*/children")
    return [int(pid) for task in tasks for pid in task.read_text().split()]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGKILL, "worker_lost"), (signal.SIGSEGV, "decoding_failed")]
)
def test_a_process_that_dies_is_its_recording_s_error(
    tmp_path: Path, plan: Plan, write_talker: Any, number: signal.Signals, code: str
) -> None:
    for name in ("a", "b", "c"):
        write_talker(tmp_path / f"{name}.wav", seconds=LONG_S if name == "b" else 1.04)
    found = find_recordings([str(tmp_path / "*.wav")])
    before, killed = set(children()), set()

    def told(recording: FoundRecording, share: float) -> None:
        if recording.place.name == "b.wav" and not killed:
            assert share < 1
            (worker,) = set(children()) - before
            killed.add(worker)
            os.kill(worker, number)

    records = {Path(record["path"]).stem: record for record in localize_here(plan, found, 1, told)}
    assert records["b"]["error"]["code"] == code
    assert [records[name]["error"] for name in ("a", "c")] == [None, None]
    assert records["a"]["windows"] == records["c"]["windows"]
    assert set(children()) == before


def test_a_run_that_is_given_up_leaves_no_processes(
    tmp_path: Path, plan: Plan, write_talker: Any
) -> None:
    before = children()
    for name in ("a", "b"):
        write_talker(tmp_path / f"{name}.wav", seconds=1.04 if name == "a" else LONG_S)
    run = localize_here(plan, find_recordings([str(tmp_path / "*.wav")]), 2, lambda *_: None)
    next(run)
    run.close()  # type: ignore[attr-defined]  # a generator
    assert children() == before


def test_processes_that_do_not_come_up_end_the_run(
    tmp_path: Path, plan: Plan, write_talker: Any
) -> None:
    before = children()
    found = find_recordings([str(write_talker(tmp_path / "a.wav"))])
    (first, *_) = plan.setup.bundles
    broken = replace(first, content={**first.content, "covariance.onnx": b"no graph"})
    unusable = replace(plan, setup=replace(plan.setup, bundles=(broken,)))
    with pytest.raises(WorkerLost):
        list(localize_here(unusable, found, 1, lambda *_: None))
    assert children() == before
