"""Who may import whom: the service runs without torch and never looks into the training code."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORBIDDEN = {"torch", "model_export", "onnx", "onnxscript"}
LAYERS = ("doa", "inference", "streaming", "api")
"""A room may import those to its left"""


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


MODULES = sorted((ROOT / "service").rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_service_imports_no_training_code(path: Path) -> None:
    assert not FORBIDDEN & {name.split(".")[0] for name in imports(path)}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_rooms_import_only_rooms_below(path: Path) -> None:
    room = path.relative_to(ROOT / "service").parts[0]
    if room not in LAYERS:
        return
    above = LAYERS[LAYERS.index(room) + 1 :]
    used = {name.split(".")[1] for name in imports(path) if name.startswith("service.")}
    assert not used & {*above, "app", "server", "cli"}


@pytest.mark.parametrize("path", sorted((ROOT / "service" / "client").glob("*.py")))
def test_the_client_imports_only_the_protocol_and_the_errors(path: Path) -> None:
    rooms = {name.split(".")[1] for name in imports(path) if name.startswith("service.")}
    assert rooms <= {"client", "protocol", "errors"}


def test_the_running_service_has_loaded_no_torch() -> None:
    code = (
        "import sys; from service.app import create_app; create_app(); "
        "print(sorted({'torch', 'model_export', 'matplotlib'} & set(sys.modules)))"
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
