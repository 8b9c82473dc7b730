"""The engine ``local``: worker processes of this machine, a thread for each."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from queue import SimpleQueue

from service.batch.archive import FoundRecording
from service.batch.plan import Plan
from service.batch.record import Record
from service.batch.worker import BatchWorker, Told

Message = Record | tuple[FoundRecording, float] | BaseException
"""A record, a recording's progress from 0 to 1, or the exception that ended a thread"""


def localize_here(
    plan: Plan, recordings: Sequence[FoundRecording], jobs: int, told: Told
) -> Iterator[Record]:
    """Localize recordings in ``jobs`` processes; yields records as they are done.

    Raises
    ------
    WorkerLost
        If a process does not start.
    """
    waiting = deque(recordings)
    heard: SimpleQueue[Message] = SimpleQueue()
    workers: list[BatchWorker] = []
    threads = [
        threading.Thread(target=_work, args=(plan, waiting, workers, heard), daemon=True)
        for _ in range(min(jobs, len(recordings)))
    ]
    for thread in threads:
        thread.start()
    left = len(recordings)
    try:
        while left:
            message = heard.get()
            if isinstance(message, BaseException):
                raise message
            if isinstance(message, tuple):
                told(*message)
            else:
                left -= 1
                yield message
    finally:
        waiting.clear()
        for worker in workers:
            worker.kill()
        for thread in threads:
            thread.join()


def _work(
    plan: Plan,
    waiting: deque[FoundRecording],
    workers: list[BatchWorker],
    heard: SimpleQueue[Message],
) -> None:
    """Localize recordings in a thread until none waits."""
    try:
        worker = BatchWorker(plan)
        workers.append(worker)
        try:
            for found in _taken(waiting):
                heard.put(worker.record(found, lambda *share: heard.put(share)))
        finally:
            worker.end()
    except BaseException as error:
        heard.put(error)


def _taken(waiting: deque[FoundRecording]) -> Iterator[FoundRecording]:
    """Waiting recordings one by one, until other threads have taken the last one."""
    with suppress(IndexError):
        while True:
            yield waiting.popleft()
