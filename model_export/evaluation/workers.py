"""Worker processes of an evaluation: results do not depend on their number."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Self, TypeVar

from rich.progress import track

from model_export.evaluation.methods import Methods
from service.doa.types import FloatArray

CHUNK = 8
"""Tasks that a process takes at once"""

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class Inputs:
    """Inputs of every task; each process has its own copy."""

    methods: Methods
    speech: Sequence[FloatArray]
    seed: int


class Workers:
    """Processes with one thread each; a single worker is this process itself."""

    def __init__(self, inputs: Inputs, pool: ProcessPoolExecutor | None, count: int) -> None:
        self.inputs, self._pool, self._count = inputs, pool, count

    @classmethod
    @contextmanager
    def start(cls, inputs: Inputs, count: int = 1) -> Iterator[Self]:
        """Start ``count`` workers, which end with the context."""
        if count == 1:
            yield cls(inputs, None, count)
            return
        # Not forked: only a fresh process reads numpy's number of threads from the environment.
        spawn = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, spawn, initializer=_begin, initargs=(inputs,))
        try:
            yield cls(inputs, pool, count)
        finally:
            pool.shutdown(cancel_futures=True)

    def map(
        self, run: Callable[[Inputs, TaskT], ResultT], tasks: Sequence[TaskT], description: str
    ) -> list[ResultT]:
        """Every task's result, in the tasks' order; ``run`` must be a module-level function."""
        if not tasks:
            return []
        results: Iterable[ResultT]
        if self._pool is None:
            results = (run(self.inputs, task) for task in tasks)
        else:
            chunk = max(1, min(CHUNK, len(tasks) // (4 * self._count)))
            results = self._pool.map(partial(_run, run), tasks, chunksize=chunk)
        return list(track(results, total=len(tasks), description=description))


_inputs: Inputs | None = None
"""Inputs of this worker process"""


def _begin(inputs: Inputs) -> None:
    global _inputs
    _inputs = inputs


def _run(run: Callable[[Inputs, TaskT], ResultT], task: TaskT) -> ResultT:
    assert _inputs is not None
    return run(_inputs, task)
