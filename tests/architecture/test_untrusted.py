"""What the service never does with what others send: unpickle, evaluate, connect, parse XML."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "service").rglob("*.py"))
CODE_FROM_DATA = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "xml"}
NETWORK = {"urllib.request", "http.client", "ftplib", "smtplib", "requests", "httpx", "httpx2"}
CLIENTS = {"client", "cli"}
"""Rooms that run on the user's machine and connect to where the user says"""


def ids(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def called(tree: ast.AST) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_pickle_is_only_spoken_between_the_service_and_its_own_workers(path: Path) -> None:
    found = {name.split(".")[0] for name in imported(ast.parse(path.read_text()))}
    allowed = {"pickle"} if "worker" in path.stem else set()
    assert not (found & CODE_FROM_DATA) - allowed


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_arrays_are_loaded_without_pickle_and_nothing_is_evaluated(path: Path) -> None:
    for name, call in called(ast.parse(path.read_text())):
        assert name not in ("eval", "exec", "compile", "os.system", "os.popen"), path
        keywords = {k.arg: ast.unparse(k.value) for k in call.keywords}
        assert keywords.get("shell", "False") == "False", path
        if name in ("np.load", "numpy.load"):
            assert keywords.get("allow_pickle") == "False", path


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_the_service_connects_to_nobody(path: Path) -> None:
    if path.relative_to(ROOT / "service").parts[0] in CLIENTS:
        return
    tree = ast.parse(path.read_text())
    assert not set(imported(tree)) & NETWORK
    connecting = {"socket.create_connection", "asyncio.open_connection", "connect"}
    assert not {name for name, _ in called(tree)} & connecting
