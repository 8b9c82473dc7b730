"""Work on a stream of inputs in a few processes, with the results in the inputs' order.

Threads would spend a third of their time on the interpreter's lock: behind the network a window is
some two hundred short calls of numpy. A recording therefore forks its helpers. They share the
bundle's memory with it and load nothing; the inputs' arrays reach them through shared memory.
"""

from __future__ import annotations

import ctypes
import logging
import mmap
import os
import pickle
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from itertools import chain, count, islice
from multiprocessing import get_context
from typing import Any, TypeVar

from neuralmusic.errors import WorkerLost

log = logging.getLogger(__name__)

InputT = TypeVar("InputT")
ResultT = TypeVar("ResultT")

FEW = 5
"""Fewest inputs that are worth processes"""
AHEAD = 2
"""Inputs per process that are sent before the first result is awaited"""
ALIGNMENT = 64
"""Bytes; every array begins at a multiple"""
NICENESS = 10
"""Nice value of helpers: streams and requests that somebody waits for go first"""
PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, slots=True)
class Sent:
    """An input on its way to a helper."""

    pickled: bytes
    spans: tuple[tuple[int, int], ...]
    """Start and end of each array in the shared memory"""


class Mailbox:
    """Shared memory in slots of one size; each holds the arrays of one input."""

    def __init__(self, slots: int, slot_size: int) -> None:
        self._slots, self._slot_size = slots, slot_size
        self._memory = memoryview(mmap.mmap(-1, max(1, slots * slot_size)))

    def send(self, number: int, each: object) -> Sent:
        """Copy the contiguous arrays of input ``number`` over those of input ``number - slots``."""
        arrays: list[pickle.PickleBuffer] = []
        pickled = pickle.dumps(each, protocol=5, buffer_callback=arrays.append)
        begin = number % self._slots * self._slot_size
        spans = tuple(_spans(begin, arrays))
        if spans and spans[-1][1] > begin + self._slot_size:
            return Sent(pickle.dumps(each), ())
        for (first, last), array in zip(spans, arrays, strict=True):
            self._memory[first:last] = array.raw()
        return Sent(pickled, spans)

    def receive(self, sent: Sent) -> Any:
        """The input; its arrays are views that are valid until the slot is used again."""
        return pickle.loads(sent.pickled, buffers=[self._memory[a:b] for a, b in sent.spans])


def size_of(each: object) -> int:
    """Bytes that an input's arrays take in a slot."""
    arrays: list[pickle.PickleBuffer] = []
    pickle.dumps(each, protocol=5, buffer_callback=arrays.append)
    return max((last for _, last in _spans(0, arrays)), default=0) + ALIGNMENT


def _spans(begin: int, arrays: Iterable[pickle.PickleBuffer]) -> Iterator[tuple[int, int]]:
    for array in arrays:
        begin = -(-begin // ALIGNMENT) * ALIGNMENT
        yield begin, (begin := begin + array.raw().nbytes)


_work: Callable[[Any], Any]
"""A helper's function, set before the fork so that it need not be pickled"""
_mailbox: Mailbox


def in_order(
    work: Callable[[InputT], ResultT], inputs: Iterable[InputT], processes: int
) -> Iterator[tuple[InputT, ResultT]]:
    """Yield every input with its result; at most two inputs per process are in work meanwhile.

    With one process, or few inputs, the caller itself does the work; so it does on a system without
    semaphores (``/dev/shm``). Results must not be views of the inputs' arrays.

    Raises
    ------
    WorkerLost
        If a process ended before its work was done.
    """
    inputs = iter(inputs)
    alone = processes == 1 or sys.platform != "linux"  # other systems' libraries fail in a fork
    first = list(islice(inputs, 0 if alone else FEW))
    most = AHEAD * processes
    pool = None
    if len(first) == FEW:
        mailbox = Mailbox(most + 1, max(map(size_of, first)))
        pool = _pool(processes, partial(_take_up, work, mailbox, os.getpid()))
    if pool is None:
        for each in chain(first, inputs):
            yield each, work(each)
        return
    ahead: deque[tuple[InputT, Future[ResultT]]] = deque()
    try:
        for number, each in zip(count(), chain(first, inputs)):
            ahead.append((each, pool.submit(_do, mailbox.send(number, each))))
            if len(ahead) > most:
                given, future = ahead.popleft()
                yield given, future.result()
        for given, future in ahead:
            yield given, future.result()
    except BrokenProcessPool as error:
        raise WorkerLost("a process that localized this recording ended: send it again") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _pool(processes: int, take_up: Callable[[], None]) -> ProcessPoolExecutor | None:
    """The helpers, None where the system has no semaphores for them."""
    try:
        return ProcessPoolExecutor(processes, get_context("fork"), take_up)
    except OSError as error:
        log.warning("recordings are localized by one process: %s (is /dev/shm there?)", error)
        return None


def _take_up(work: Callable[[InputT], ResultT], mailbox: Mailbox, parent: int) -> None:
    """Set up a helper process that ends with its parent, however that ends."""
    global _work, _mailbox
    _work, _mailbox = work, mailbox
    os.nice(NICENESS)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the pool ends the others when one is lost
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent answers Ctrl-C
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _do(sent: Sent) -> Any:
    return _work(_mailbox.receive(sent))
