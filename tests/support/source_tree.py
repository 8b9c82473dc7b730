"""The project's own modules, read and not run: what each imports and calls."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = {
    "neuralmusic": ROOT / "client" / "neuralmusic",
    "service": ROOT / "service",
    "model_export": ROOT / "model_export",
}
"""Folders by package"""

TOLD = {"shell", "allow_pickle"}
"""Keywords that the tests ask about"""

Call = tuple[str, dict[str, str]]
"""Function of a call and the keywords of ``TOLD``, as they are written"""


@dataclass(frozen=True)
class Module:
    """What one module reaches for."""

    imports: tuple[str, ...]
    """Imports at its top or later; ``from a import b`` is ``a.b``"""
    calls: tuple[Call, ...]


@cache
def modules(package: str) -> dict[str, Module]:
    """Modules of a package by their dotted names."""
    folder = FOLDERS[package]
    return {
        dotted(path.relative_to(folder.parent)): module(path.read_text())
        for path in sorted(folder.rglob("*.py"))
    }


def module(text: str) -> Module:
    nodes = list(ast.walk(ast.parse(text)))
    calls = tuple(call(node) for node in nodes if isinstance(node, ast.Call))
    return Module(tuple(name for node in nodes for name in imported(node)), calls)


def dotted(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module: str) -> str:
    """The folder or loose file directly below the package; the package itself is ``__init__``."""
    return (*module.split("."), "__init__")[1]


def imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"relative import of {node.module}"
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def call(node: ast.Call) -> Call:
    named = {str(each.arg): ast.unparse(each.value) for each in node.keywords if each.arg in TOLD}
    return ast.unparse(node.func), named


def own_imports(package: str) -> Iterator[tuple[str, str]]:
    """Which module of a package imports which other one of it."""
    known = modules(package)
    for importing, found in known.items():
        for name in found.imports:
            if name.split(".")[0] == package:
                yield importing, name if name in known else name.rpartition(".")[0]
