"""The project's own modules, read and not run: what each imports and calls."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def modules(package: str) -> dict[str, ast.Module]:
    """Parsed modules of a package by their dotted names."""
    return {
        dotted(path): ast.parse(path.read_text()) for path in sorted((ROOT / package).rglob("*.py"))
    }


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module: str) -> str:
    """The folder or loose file directly below the package; the package itself is ``__init__``."""
    return (*module.split("."), "__init__")[1]


def imported(tree: ast.AST) -> Iterator[str]:
    """Everything a module imports, at its top or later; ``from a import b`` is ``a.b``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module}"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def own_imports(package: str) -> Iterator[tuple[str, str]]:
    """Which module of a package imports which other one of it."""
    known = modules(package)
    for module, tree in known.items():
        for name in imported(tree):
            if name.split(".")[0] == package:
                yield module, name if name in known else name.rpartition(".")[0]


def calls(tree: ast.AST) -> Iterator[tuple[str, dict[str, str]]]:
    """Each call's function and its keywords, as they are written."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), {str(k.arg): ast.unparse(k.value) for k in node.keywords}
