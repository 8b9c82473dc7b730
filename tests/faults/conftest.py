"""Figures of every fault: printed, and with ``FIGURES=docs`` written to ``docs/faults.json``."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bench.reliability import write_table

FIGURES = pytest.StashKey[dict[str, Any]]()

Figures = Callable[..., None]


def pytest_configure(config: pytest.Config) -> None:
    config.stash[FIGURES] = {}


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Iterator[Figures]:
    """``figures(did, name=value, ...)``: what was done and what happened, once the test passed."""
    noted: dict[str, Any] = {}

    def note(did: str, **values: object) -> None:
        noted.update(
            did=did, happened={name.replace("_", " "): str(v) for name, v in values.items()}
        )
        print(
            f"\n{did}",
            *(f"  {name}: {value}" for name, value in noted["happened"].items()),
            sep="\n",
        )

    failed = request.session.testsfailed
    yield note
    if noted and request.session.testsfailed == failed:
        test = Path(request.node.path).name + "::" + request.node.name
        request.config.stash[FIGURES][test] = noted


def pytest_sessionfinish(session: pytest.Session) -> None:
    folder, measured = os.environ.get("FIGURES"), session.config.stash[FIGURES]
    if not folder or not measured:
        return
    path = Path(folder) / "faults.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    faults = dict(sorted({**known, **measured}.items()))
    path.write_text(json.dumps(faults, indent=1, ensure_ascii=False) + "\n")
    write_table(Path(folder))
