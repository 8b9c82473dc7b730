"""Work on a stream of inputs in a few processes, the results in the inputs' order.

Threads would hand the interpreter's lock around for a third of their time: behind the network a
window is some two hundred short calls of numpy. So a recording forks its helpers, which share the
bundle's memory with it and need not load anything.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import chain, islice
from multiprocessing import get_context
from typing import Any, TypeVar

from service.errors import WorkerLost

InputT = TypeVar("InputT")
ResultT = TypeVar("ResultT")

FEW = 8
"""Inputs that are not worth a process"""
AHEAD = 2
"""Inputs per process that are handed over before the first one's result is asked for"""
PR_SET_PDEATHSIG = 1

_work: Callable[[Any], Any]
"""What a helper does, from before the fork: it need not be pickled"""


def in_order(
    work: Callable[[InputT], ResultT], inputs: Iterable[InputT], processes: int
) -> Iterator[tuple[InputT, ResultT]]:
    """Every input with its result; at most two inputs per process are ahead of them.

    With one process, or few inputs, nothing is ahead: the caller does the work.

    Raises
    ------
    WorkerLost
        If a process ended before its work was done.
    """
    inputs = iter(inputs)
    alone = processes == 1 or sys.platform != "linux"  # elsewhere system libraries fail in a fork
    first = list(islice(inputs, 0 if alone else FEW))
    if len(first) < FEW:
        for each in chain(first, inputs):
            yield each, work(each)
        return
    context = get_context("fork")
    pool = ProcessPoolExecutor(processes, context, _take_up, (work, os.getpid()))
    ahead: deque[tuple[InputT, Future[ResultT]]] = deque()
    try:
        for each in chain(first, inputs):
            ahead.append((each, pool.submit(_do, each)))
            if len(ahead) > AHEAD * processes:
                given, future = ahead.popleft()
                yield given, future.result()
        for given, future in ahead:
            yield given, future.result()
    except BrokenProcessPool as error:
        raise WorkerLost("a process that localized this recording ended: send it again") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _take_up(work: Callable[[InputT], ResultT], parent: int) -> None:
    """Begin a helper's life, which ends with its parent's, however that ends."""
    global _work
    _work = work
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _do(each: Any) -> Any:
    return _work(each)
