"""The pool that localizes recordings: bounded processes, a bounded queue."""

from __future__ import annotations

import asyncio
import logging
import signal
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any, BinaryIO

import anyio
import anyio.from_thread
import anyio.to_thread

from neuralmusic.errors import DecodingFailed, DoaError, Overloaded, TooSlow, WorkerLost
from service.lifecycle import Lifecycle, Phase
from service.observability.metrics import Metrics
from service.recordings.job import HeaderRead, Localized, Outcome, RecordingJob, Refused, Report
from service.workers.link import Link, Setup
from service.workers.process import READY_S, WorkerProcess

log = logging.getLogger(__name__)

CRASHES = {signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL}
"""Signals by which a faulty decoder ends a process; other signals come from outside"""

TAKEN_S = 10.0
"""Seconds within which a ready process must take a recording: it may have been stopped"""
LOOK_S = 1.0
"""Seconds between two looks whether a recording that waits is still wanted"""

Reserve = Callable[[float], None]
"""Reserves seconds of audio, or raises a DoaError; takes negative ones back"""
StillWanted = Callable[[], Coroutine[Any, Any, None]]
"""Raises an exception of the caller's once nobody waits for the answer"""


class RecordingWorker:
    """One worker process; every call blocks the thread that makes it."""

    def __init__(self, setup: Setup, stall_s: float) -> None:
        self.setup = setup
        self._stall_s = stall_s
        self._process = WorkerProcess("service.workers.recording")
        self._link = Link(self._process.connection)
        self.pid = self._process.pid
        self.ready = False

    @property
    def alive(self) -> bool:
        """False once its process has ended."""
        return self._process.alive

    def wait_ready(self) -> None:
        """Set the worker up; WorkerLost where it does not come up in time."""
        try:
            self._process.connection.settimeout(READY_S)
            self._link.send(self.setup)
            self._link.receive()
            self._process.connection.settimeout(self._stall_s)
        except (EOFError, OSError) as error:
            self._lost(error)
            raise WorkerLost(
                "a process that localizes recordings did not come up: try again later"
            ) from error
        self.ready = True

    def localize(
        self, job: RecordingJob, file: BinaryIO, check: Callable[[Report], None]
    ) -> Localized:
        """Localize one recording.

        Parameters
        ----------
        check : callable
            Called with every report; an exception of it ends the job and passes through.

        Raises
        ------
        DoaError
            If the recording or the options cannot be used.
        DecodingFailed, WorkerLost
            If the process crashed, stalled or was killed; the worker is then unusable.
        """
        connection = self._process.connection
        try:
            connection.settimeout(min(TAKEN_S, self._stall_s))
            self._link.send(job, [file.fileno()])
            self._link.receive()
        except (EOFError, OSError) as error:
            lost = self._lost(error)
            if isinstance(error, TimeoutError):  # before it could look at the recording
                lost = WorkerLost("the process for this recording did not take it: try again")
            raise lost from error
        try:
            connection.settimeout(self._stall_s)
            outcome = self._converse(check)
        except (EOFError, OSError) as error:
            raise self._lost(error) from error
        if isinstance(outcome, Refused):
            raise outcome.error
        return outcome

    def kill(self) -> None:
        """Kill the process, whatever it does."""
        self._process.kill()

    def end(self) -> None:
        """Stop an idle worker."""
        self._process.end()

    def _converse(self, check: Callable[[Report], None]) -> Outcome:
        while True:
            message = self._link.receive()
            if not isinstance(message, Report):
                outcome: Outcome = message
                return outcome
            try:
                check(message)
            except BaseException:
                self._link.send(False)
                self._link.receive()
                raise
            self._link.send(True)

    def _lost(self, error: Exception) -> DoaError:
        """Kill a process that ended or stalled; return the error to report."""
        stalled = isinstance(error, TimeoutError)
        if stalled:
            self._process.kill()
        status = self._process.end()
        log.error("recording worker %s ended with status %s: %r", self.pid, status, error)
        if stalled:
            return DecodingFailed(
                f"localizing the recording made no progress for {self._stall_s:g} s and was "
                "stopped: send it as WAV or FLAC, or in pieces"
            )
        if status is not None and -status in CRASHES:
            return DecodingFailed(
                "the decoder crashed on this recording: re-encode it as WAV or FLAC"
            )
        return WorkerLost("the process that localized this recording ended: send it again")


class RecordingWorkers:
    """Localizes at most ``most`` recordings at a time, queues ``queue`` more, refuses others."""

    def __init__(
        self, most: int, queue: int, stall_s: float, metrics: Metrics, lifecycle: Lifecycle
    ) -> None:
        self._turns = asyncio.Semaphore(most)
        self._limiter = anyio.CapacityLimiter(most)
        self._capacity = most + queue
        self._stall_s = stall_s
        self._metrics = metrics
        self._lifecycle = lifecycle
        self._lock = threading.Lock()
        self._idle: list[RecordingWorker] = []
        self._busy: set[RecordingWorker] = set()
        self.admitted = 0
        """Recordings being localized or waiting"""
        self.setup: Setup | None = None
        """Settings and models of new workers; set before the first one is needed"""

    def check(self) -> None:
        """Raise Draining or Overloaded where one more recording would be refused."""
        self._lifecycle.check(Phase.ENDING)
        if self.admitted >= self._capacity:
            raise Overloaded(
                f"{self.admitted} recordings are being localized or waiting: try again later"
            )

    async def run(
        self, job: RecordingJob, file: BinaryIO, reserve: Reserve, still_wanted: StillWanted
    ) -> Localized:
        """Localize a recording once a worker is free.

        The job ends once nobody waits for it: a robot that times out and retries would otherwise
        pile up work. Exceptions of ``reserve`` and ``still_wanted`` pass through.
        """
        audio_s = share = began = 0.0

        def check(message: Report) -> None:
            nonlocal audio_s, share, began
            self._lifecycle.check(Phase.ENDING)
            if isinstance(message, HeaderRead):
                reserve(message.duration)
                audio_s, began = message.duration, time.monotonic()
            else:
                share = message.share
                self._check_time(audio_s, began)
            anyio.from_thread.run(still_wanted)

        self.check()
        self.admitted += 1
        came = time.monotonic()
        try:
            async with self._turn(still_wanted):
                localized = await anyio.to_thread.run_sync(
                    self._localize, job, file, check, limiter=self._limiter
                )
        except BaseException:
            reserve(-audio_s * (1 - share))
            raise
        finally:
            self.admitted -= 1
        self._count(localized, audio_s, time.monotonic() - came)
        return localized

    @property
    def pids(self) -> list[int]:
        """Ids of the running processes."""
        with self._lock:
            return [worker.pid for worker in (*self._idle, *self._busy)]

    async def start(self) -> None:
        """Start the first worker and wait until it is ready."""
        await anyio.to_thread.run_sync(lambda: self._give_back(self._take()))

    def prepare(self, setup: Setup) -> RecordingWorker:
        """Start a worker with a new setup, for ``renew``; raises WorkerLost if that fails."""
        worker = self._started(setup)
        with self._lock:
            self._busy.discard(worker)
        return worker

    def renew(self, prepared: RecordingWorker) -> None:
        """Send new recordings to workers with this one's setup; running ones finish."""
        with self._lock:
            self.setup = prepared.setup
            idle, self._idle = self._idle, [prepared]
        for worker in idle:
            worker.end()

    @property
    def ready(self) -> bool:
        """Whether there is a process that could take a recording, now or after another one."""
        with self._lock:
            return any(each.ready and each.alive for each in (*self._idle, *self._busy))

    @property
    def lacking(self) -> bool:
        """Whether an idle process has ended, or there is none at all."""
        with self._lock:
            return not (self._idle or self._busy) or not all(each.alive for each in self._idle)

    def tend(self) -> None:
        """Replace idle processes that have ended by one; blocks until it is ready."""
        with suppress(WorkerLost):  # it was logged and counted
            if not self._lifecycle.reached(Phase.ENDING):
                self._give_back(self._take())

    def stop(self) -> None:
        """End all processes; the lifecycle must be ending."""
        with self._lock:
            idle, self._idle = self._idle, []
            for worker in self._busy:
                worker.kill()
        for worker in idle:
            worker.end()

    @asynccontextmanager
    async def _turn(self, still_wanted: StillWanted) -> AsyncIterator[None]:
        """Wait for a worker to be free, as long as somebody waits for the answer."""
        turn = asyncio.ensure_future(self._turns.acquire())
        try:
            while not turn.done():
                await asyncio.wait((turn,), timeout=LOOK_S)
                if not turn.done():
                    await still_wanted()
            yield
        finally:
            if not turn.cancel():
                self._turns.release()

    def _check_time(self, audio_s: float, began: float) -> None:
        """Raise TooSlow where a recording takes longer than it lasts, and the stall's time."""
        most = self._stall_s + audio_s
        if time.monotonic() - began > most:
            raise TooSlow(
                f"the recording of {audio_s:.0f} s was not localized within {most:.0f} s: try "
                "later, or with a larger hop_s, fewer microphones or a classical method"
            )

    def _count(self, localized: Localized, audio_s: float, seconds: float) -> None:
        """Count a recording and the seconds until its answer."""
        self._metrics.worked("recording", max(seconds - localized.seconds, 0.0), localized.seconds)
        self._metrics.audio("recording", audio_s)
        for windows, times in localized.stretches.items():
            for _ in range(times):
                self._metrics.batch(windows)

    def _localize(
        self, job: RecordingJob, file: BinaryIO, check: Callable[[Report], None]
    ) -> Localized:
        worker = self._take()
        try:
            localized = worker.localize(job, file, check)
        except (DecodingFailed, WorkerLost):
            with self._lock:
                self._busy.discard(worker)
            self._lifecycle.check(Phase.ENDING)
            self._metrics.worker_lost("recording")
            raise
        except BaseException:
            self._give_back(worker)
            raise
        self._give_back(worker)
        return localized

    def _take(self) -> RecordingWorker:
        """An idle worker, or a new one where none is idle."""
        with self._lock:
            ended = [each for each in self._idle if not each.alive]
            self._idle = [each for each in self._idle if each.alive]
            worker = self._idle.pop() if self._idle else None
            if worker is not None:
                self._busy.add(worker)
        for each in ended:
            log.error("recording worker %s ended while it was idle", each.pid)
            self._metrics.worker_lost("recording")
            each.end()
        if worker is not None:
            return worker
        assert self.setup is not None
        return self._started(self.setup)

    def _started(self, setup: Setup) -> RecordingWorker:
        """A new worker that is ready; busy, so that ``stop`` ends one that does not come up."""
        with self._lock:
            worker = RecordingWorker(setup, self._stall_s)
            self._busy.add(worker)
        try:
            worker.wait_ready()
        except BaseException:
            with self._lock:
                self._busy.discard(worker)
            self._metrics.worker_lost("recording")
            raise
        return worker

    def _give_back(self, worker: RecordingWorker) -> None:
        with self._lock:
            self._busy.discard(worker)
            keep = worker.setup is self.setup and not self._lifecycle.reached(Phase.ENDING)
            if keep:
                self._idle.append(worker)
        if not keep:
            worker.end()
