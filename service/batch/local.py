"""The engine ``local``: processes of this machine, one recording each at a time.

Not a ``ProcessPoolExecutor``: a process that a decoder brings down would break the whole pool, and
nobody would know which recording it was.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait

from service.batch.archive import FoundRecording
from service.batch.plan import Plan
from service.batch.record import Record, RecordingLocalizer, failed
from service.errors import DoaError, WorkerLost

Told = Callable[[FoundRecording, float], None]
"""Takes the share of a recording that is done"""

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
READY = "ready"
END_S = 2.0
"""Seconds that a process has to end before it is killed"""


def localize_here(
    plan: Plan, recordings: Sequence[FoundRecording], jobs: int, told: Told
) -> Iterator[Record]:
    """Localize recordings in ``jobs`` processes; yields records as they are done.

    A process that dies over a recording is that recording's error, and is replaced.

    Raises
    ------
    DoaError
        If a process cannot begin.
    """
    waiting = deque(recordings)
    workers: list[Worker] = []
    try:
        while waiting or any(worker.at for worker in workers):
            busy = sum(worker.at is not None for worker in workers)
            while len(workers) < min(jobs, busy + len(waiting)):
                workers.append(Worker(plan))
            for worker in workers:
                if waiting and worker.idle:
                    worker.begin(waiting.popleft())
            by_pipe = {worker.pipe: worker for worker in workers}
            for pipe in wait(list(by_pipe)):
                worker = by_pipe[pipe]  # type: ignore[index]  # wait gives what it was given
                record = worker.listen(told)
                if worker.lost:
                    workers.remove(worker)
                if record is not None:
                    yield record
    finally:
        for worker in workers:
            worker.end(at_once=True)


class Worker:
    """One process, and the recording that it is at."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, plan), daemon=True)
        with _one_thread():
            self._process.start()
        theirs.close()
        self.idle = False
        self.lost = False
        self.at: FoundRecording | None = None

    def begin(self, found: FoundRecording) -> None:
        """Have a recording localized."""
        self.idle, self.at = False, found
        with suppress(OSError):  # it has ended, as its pipe will say
            self.pipe.send(found)

    def listen(self, told: Told) -> Record | None:
        """Take the process' next message, and its recording's record if that is what it is.

        Raises
        ------
        DoaError
            If it could not begin.
        """
        try:
            message = self.pipe.recv()
        except (EOFError, OSError):
            return self._lose()
        if isinstance(message, DoaError):
            raise message
        if isinstance(message, float):
            assert self.at is not None
            told(self.at, message)
            return None
        self.idle, self.at = True, None
        return None if message == READY else message

    def end(self, *, at_once: bool = False) -> int | None:
        """End the process; gives its exit code, which is minus the signal that killed it."""
        self.lost = True
        self.pipe.close()
        if at_once:
            self._process.kill()
        self._process.join(END_S)
        self._process.kill()
        self._process.join()
        code = self._process.exitcode
        self._process.close()
        return code

    def _lose(self) -> Record:
        how = _ending(self.end())
        if self.at is None:
            raise WorkerLost(f"a process {how} before it could begin: is there enough memory?")
        detail = (
            f"the process that localized this recording {how}: the file may be damaged, or memory "
            "short; run the same command again to try it once more"
        )
        return failed(self.at, self._plan, WorkerLost(detail))


def _work(pipe: Connection, plan: Plan) -> None:
    """What a process does, until the run's end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run ends its processes itself
    try:
        localizer = RecordingLocalizer(plan)
    except DoaError as error:
        pipe.send(error)
        return
    with suppress(EOFError, OSError):
        pipe.send(READY)
        while True:
            pipe.send(localizer.record(pipe.recv(), pipe.send))


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread of linear algebra for processes that are started inside."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
