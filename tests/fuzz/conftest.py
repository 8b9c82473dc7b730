"""The service that is fuzzed: in processes of its own, as an operator starts it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .served import Served


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One for every file of tests; it must be alive in the end, and its log without tracebacks."""
    running = Served(tmp_path_factory.mktemp("service"), workers="2", stream_workers="2")
    try:
        yield running
        assert running.alive
    finally:
        running.stop()
    assert "Traceback" not in running.log.read_text(errors="replace")
