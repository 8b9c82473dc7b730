"""BLAS and telemetry variables are set where processes start, not where modules are imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

from service.machine.environment import TELEMETRY, VARIABLES
from service.workers.link import worker_environment

LOOKING = """
import builtins, importlib.abc, json, os, sys

class Looking(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in ("numpy", "onnxruntime"):
            print(json.dumps({name: os.environ.get(name) for name in %r}), flush=True)
            os._exit(0)

sys.meta_path.insert(0, Looking())
"""
"""A process that tells the variables when numpy or onnxruntime is first imported, and ends"""
FILE = str(ROOT / "examples" / "two-talkers.flac")
ARRAY = ("--array", "respeaker-usb-4mic-v2")
PROGRAMS = {
    "serve": ["neuralmusic.cli", "serve", "--port", "0"],
    "localize": ["neuralmusic.cli", "localize", FILE, *ARRAY],
    "check": ["neuralmusic.cli", "check", FILE, *ARRAY],
    "noise": ["neuralmusic.cli", "noise", FILE, *ARRAY, "--out", "none.npz"],
    "batch": ["neuralmusic.cli", "batch", FILE, *ARRAY, "--out", "none.jsonl"],
    "bundle": ["neuralmusic.cli", "bundle", "show", "any-array"],
    "bench": ["neuralmusic.cli", "bench"],
    "model_export": ["model_export.__main__", "--threads", "1", "evaluate", "--help"],
}


def told(program: str, folder: Path) -> dict[str, str | None]:
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run(
        [sys.executable, "-c", LOOKING % (tuple(VARIABLES),) + program],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        cwd=folder,
    )
    assert done.stdout, f"numpy was never imported: {done.stderr}"
    answer: dict[str, str | None] = json.loads(done.stdout)
    return answer


@pytest.mark.parametrize("words", PROGRAMS.values(), ids=PROGRAMS)
def test_every_process_sets_them_before_numpy_is_imported(words: list[str], tmp_path: Path) -> None:
    module, *arguments = words
    program = f"from {module} import main\nmain({arguments!r})"
    assert told(program, tmp_path) == VARIABLES


@pytest.mark.parametrize("module", ["service.inference.engine", "service.app", "model_export.cli"])
def test_importing_sets_nothing(module: str, tmp_path: Path) -> None:
    assert told(f"import {module}", tmp_path) == dict.fromkeys(VARIABLES)


def test_a_call_in_another_s_process_leaves_blas_alone(tmp_path: Path) -> None:
    program = f"import service\nservice.localize({FILE!r}, array={ARRAY[1]!r})"
    assert told(program, tmp_path) == {**dict.fromkeys(VARIABLES), TELEMETRY: "1"}


def test_workers_inherit_what_the_user_has_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORT_DISABLE_TELEMETRY", "0")
    assert worker_environment()["ORT_DISABLE_TELEMETRY"] == "0"
    monkeypatch.delenv("ORT_DISABLE_TELEMETRY")
    assert worker_environment()["ORT_DISABLE_TELEMETRY"] == "1"
