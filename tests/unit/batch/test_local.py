"""The engine of this machine: processes that may die."""

from __future__ import annotations

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.batch.archive import FoundRecording, find_recordings
from service.batch.local import localize_here
from service.batch.plan import Plan
from service.errors import BundleIncompatible

LONG_S = 20.0
"""Seconds of audio, of which a part is done long before the rest"""


def test_a_process_that_dies_is_its_recording_s_error(
    tmp_path: Path, plan: Plan, write_talker: Any
) -> None:
    for name in ("a", "b", "c"):
        write_talker(tmp_path / f"{name}.wav", seconds=LONG_S if name == "b" else 1.04)
    found = find_recordings([str(tmp_path / "*.wav")])
    killed: list[int] = []

    def told(recording: FoundRecording, share: float) -> None:
        if recording.place.name == "b.wav" and not killed:
            assert share < 1
            (worker,) = multiprocessing.active_children()
            assert worker.pid is not None
            killed.append(worker.pid)
            os.kill(worker.pid, signal.SIGKILL)

    records = {Path(record["path"]).stem: record for record in localize_here(plan, found, 1, told)}
    assert records["b"]["error"]["code"] == "worker_lost"
    assert "SIGKILL" in records["b"]["error"]["detail"]
    assert [records[name]["error"] for name in ("a", "c")] == [None, None]
    assert records["a"]["windows"] == records["c"]["windows"]
    assert multiprocessing.active_children() == []


def test_a_run_that_is_given_up_leaves_no_processes(
    tmp_path: Path, plan: Plan, write_talker: Any
) -> None:
    for name in ("a", "b"):
        write_talker(tmp_path / f"{name}.wav")
    run = localize_here(plan, find_recordings([str(tmp_path / "*.wav")]), 2, lambda *_: None)
    next(run)
    run.close()  # type: ignore[attr-defined]  # a generator
    assert multiprocessing.active_children() == []


def test_processes_that_cannot_begin_end_the_run(
    tmp_path: Path, plan: Plan, write_talker: Any
) -> None:
    path = write_talker(tmp_path / "a.wav")
    neural = replace(plan, options=replace(plan.options, method=None), method="neural")
    with pytest.raises(BundleIncompatible):
        list(localize_here(neural, find_recordings([str(path)]), 1, lambda *_: None))
    assert multiprocessing.active_children() == []
