"""``neuralmusic batch --engine ray``: the same result as here, from actors that may die."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import pytest
import soundfile

pytest.importorskip("ray.serve", reason="needs Ray: pip install ./client '.[ray]'")

from command_line import run
from ray_cluster import until

from service.batch.archive import find_recordings
from service.batch.cluster import localize_on_ray
from service.batch.plan import Plan
from service.cli.inputs import generous_limits
from service.doa.array import MicrophoneArray
from service.recordings.options import LocalizeRequest
from service.recordings.results import LocalizeOptions
from service.settings import Settings

pytestmark = pytest.mark.ray

RATE = 16_000
AT_WORK = b"ray::RecordingActor.record"
"""Name that Ray gives an actor's process while it localizes"""


@pytest.fixture
def archive(
    tmp_path: Path, square: MicrophoneArray, plane_waves: Any, monkeypatch: pytest.MonkeyPatch
) -> Path:
    for name, azimuth, seconds in (("a", 90, 1.04), ("b", 270, 20.0), ("c", 0, 1.04)):
        audio = plane_waves(square, [azimuth], seconds=seconds)
        soundfile.write(tmp_path / f"{name}.wav", audio.T, RATE)
    (tmp_path / "notes.wav").write_text("no audio")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def records(path: str) -> dict[str, Any]:
    lines = Path(path).read_text().splitlines()
    return {record["path"]: record for record in map(json.loads, lines)}


def test_a_cluster_writes_what_one_machine_writes(
    cluster: None, archive: Path, square: MicrophoneArray, capsys: pytest.CaptureFixture[str]
) -> None:
    for engine, jobs in (("local", "2"), ("ray", "4")):  # the cluster has CPUs for two of them
        flags = ["--engine", engine, "--jobs", jobs, "--out", f"{engine}.jsonl"]
        code, out, _ = run(capsys, "batch", "*.wav", "--array", square.name, *flags)
        assert (code, out.splitlines()[1]) == (1, "not_audio: 1")
    assert records("ray.jsonl") == records("local.jsonl")


def test_an_actor_that_dies_is_its_recording_s_error(
    cluster: None, archive: Path, square: MicrophoneArray
) -> None:
    asked = LocalizeRequest(LocalizeOptions(square, method="norm_music"))
    plan = Plan.settle(asked, {"array": square.name}, Settings(), generous_limits())
    killer = threading.Thread(target=kill_an_actor)
    killer.start()
    found = find_recordings(["b.wav", "c.wav"])
    done = {record["path"]: record for record in localize_on_ray(plan, found, 1)}
    killer.join()
    assert done["b.wav"]["error"]["code"] == "worker_lost"
    assert done["c.wav"]["error"] is None


def kill_an_actor() -> None:
    between_looks = threading.Event()  # never set: a thread that only looks would stop the others
    os.kill(until(actor_at_work, lambda: between_looks.wait(0.02)), signal.SIGKILL)


def actor_at_work() -> int | None:
    for process in Path("/proc").iterdir():
        try:
            if process.name.isdigit() and (process / "cmdline").read_bytes().startswith(AT_WORK):
                return int(process.name)
        except OSError:  # it has ended
            continue
    return None
