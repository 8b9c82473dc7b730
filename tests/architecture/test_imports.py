"""Who may import whom: rooms only those below, the service no training code, nobody in circles."""

from __future__ import annotations

import subprocess
import sys
from graphlib import CycleError, TopologicalSorter

import pytest
from source_tree import ROOT, modules, own_imports, room

ORDER = {
    "neuralmusic": (
        ("errors",),
        ("addresses", "arrays", "client_errors", "loop_thread", "protocol", "timeout"),
        ("option_text", "recordings", "streams", "wav"),
        ("sources",),
        ("__init__",),
        ("cli",),
        ("__main__",),
    ),
    "service": (
        ("access", "doa", "lifecycle", "machine"),
        ("audio", "inference", "settings"),
        ("observability", "recordings", "startup", "streaming"),
        ("in_process", "workers"),
        ("api", "batch", "bench"),
        ("app", "connections"),
        ("server", "openapi"),
        ("cli", "ray_app"),
        ("__init__",),
        ("reference",),
    ),
    "model_export": (
        ("__init__",),
        ("simulation",),
        ("datasets", "training"),
        ("baselines", "export"),
        ("evaluation", "finetuning"),
        ("experiments",),
        ("cli",),
        ("__main__",),
    ),
}
"""Rooms from the ground up: each imports only those of the lines above it, none of its own line"""

IDLE = ("torch.", "model_export.", "matplotlib.", "opentelemetry.sdk.", "opentelemetry.exporter.")
"""Packages of extras, which the service imports only for pictures and traces"""
TRAINING = {"torch", "model_export", "onnx", "onnxscript"}
OTHERS = {"service", "model_export", "numpy", "scipy", "onnxruntime", "fastapi", "starlette"}


@pytest.mark.parametrize("package", ORDER)
def test_rooms_import_only_rooms_below(package: str) -> None:
    floor = {name: level for level, rooms in enumerate(ORDER[package]) for name in rooms}
    assert {room(module) for module in modules(package)} == set(floor)
    offenders = {
        f"{module} imports {other}"
        for module, other in own_imports(package)
        if room(module) != room(other) and floor[room(module)] <= floor[room(other)]
    }
    assert not offenders


@pytest.mark.parametrize("package", ORDER)
def test_no_modules_import_each_other_in_a_circle(package: str) -> None:
    graph: dict[str, set[str]] = {}
    for module, other in own_imports(package):
        graph.setdefault(module, set()).add(other)
    circle: list[str] = []
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = error.args[1]
    assert not circle


def test_the_service_imports_no_training_code() -> None:
    offenders = {
        f"{module} imports {name}"
        for module, found in modules("service").items()
        for name in found.imports
        if name.split(".")[0] in TRAINING
    }
    assert not offenders


def test_the_client_imports_neither_the_service_nor_its_libraries() -> None:
    offenders = {
        f"{module} imports {name}"
        for module, found in modules("neuralmusic").items()
        for name in found.imports
        if name.split(".")[0] in OTHERS
    }
    assert not offenders


def test_one_module_of_the_client_knows_the_http_library() -> None:
    found = {
        module
        for module, source in modules("neuralmusic").items()
        if any(name.split(".")[0] in ("httpx", "httpx2") for name in source.imports)
    }
    assert found == {"neuralmusic.recordings.http"}


def test_the_running_service_has_loaded_nothing_that_it_does_without() -> None:
    """Torch, and what only pictures and traces need."""
    code = (
        "import sys; from service.app import create_app; create_app(); "
        f"print([name for name in sys.modules if f'{{name}}.'.startswith({IDLE})])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("statement", ["import torch", "from model_export import train"])
def test_the_linter_knows_the_rule(statement: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "ruff", "check", "--stdin-filename", "service/doa/new.py", "-"],
        input=f"{statement}\n",
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 1
    assert "TID251" in done.stdout
