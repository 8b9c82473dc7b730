"""The pool that computes streams: worker processes, each with its share of the sessions."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from neuralmusic.errors import WorkerLost
from service.observability.metrics import Metrics
from service.streaming.work import Answer, Check, Failed, Outcome, Work
from service.workers.link import Setup, Unpacker, packed
from service.workers.process import READY_S, WorkerProcess

log = logging.getLogger(__name__)

Done = Callable[[Outcome], None]

ENOUGH = 4
"""Sessions in every worker at which another one is started, which takes 150 MB and a second"""
STALL_S = 15.0
"""Seconds without an outcome of a job, after which a worker is killed"""


@dataclass(slots=True)
class PendingWork:
    """A job without an outcome yet."""

    done: Done
    since: float
    """Loop time at which the job was submitted"""
    patient: bool
    """Whether the job is a check of the channels: it takes turns and may take long"""


class _Channel(asyncio.Protocol):
    """The service's end of a worker's socket.

    Parameters
    ----------
    receive : callable
        Called with every message.
    """

    def __init__(self, receive: Callable[[Answer], None]) -> None:
        self._receive = receive
        self._unpacker = Unpacker()
        self.ended = asyncio.Event()

    def data_received(self, data: bytes) -> None:
        """Take bytes from the worker."""
        self._unpacker.add(data)
        for message in self._unpacker.messages():
            self._receive(message)

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that either end of the socket is closed."""
        self.ended.set()


class StreamWorker:
    """One worker process and the socket to it; used on the event loop alone."""

    def __init__(self, setup: Setup, metrics: Metrics) -> None:
        self._setup = setup
        self._metrics = metrics
        self._loop = asyncio.get_running_loop()
        self._numbers = count(1)
        self._waiting: dict[int, PendingWork] = {}
        self._process: WorkerProcess | None = None
        self._reading: asyncio.Task[None] | None = None
        self._transport: asyncio.Transport | None = None
        self._unsent: list[bytes] = []
        self._deadline: asyncio.TimerHandle | None = None
        """Timer that ends a start that takes too long"""
        self._answered = 0.0
        self.sessions = 0
        """Sessions computed here"""
        self.retired = False
        """Whether the worker takes no more sessions and ends with its last one"""
        self.lost = False
        self.ready = asyncio.Event()

    def start(self) -> None:
        """Start the process; jobs may be submitted at once."""
        self._process = WorkerProcess("service.workers.stream")
        self._deadline = self._loop.call_later(READY_S, self._give_up, READY_S)
        self._unsent.insert(0, packed(self._setup))
        self._reading = self._loop.create_task(self._attend(self._process))

    def submit(self, work: Work, done: Done | None = None) -> None:
        """Submit a job; ``done`` is called with its outcome."""
        if self.lost:
            if done is not None:
                self._loop.call_soon(done, Failed(worker_lost()))
            return
        number = next(self._numbers)
        message = packed((number, work))
        if done is not None:
            self._waiting[number] = PendingWork(done, self._loop.time(), isinstance(work, Check))
        if self._transport is None:
            self._unsent.append(message)
        else:
            self._transport.write(message)

    @property
    def pid(self) -> int | None:
        """Id of the process, once it has started."""
        return self._process.pid if self._process else None

    def watch(self, now: float) -> None:
        """Kill a process that has stalled: its streams then end with an error, not in silence."""
        due = (each.since for each in self._waiting.values() if not each.patient)
        oldest = max(min(due, default=now), self._answered)
        if self.ready.is_set() and now - oldest > STALL_S:
            self._give_up(STALL_S)

    def _give_up(self, seconds: float) -> None:
        """Kill it; whoever waits for it is told, even where the system lets it hang on."""
        assert self._process is not None
        log.error("stream worker %s made no progress for %.0f s: killed", self.pid, seconds)
        self._process.kill()
        if self._transport is not None:
            self._transport.abort()

    async def stop(self) -> None:
        """End the process."""
        self.lost = True
        self._come_up()
        if self._transport is not None:
            # A close would wait until all is sent, to a worker that waits until all is read.
            self._transport.abort()
        if self._reading is not None:
            await asyncio.gather(self._reading, return_exceptions=True)

    async def _attend(self, process: WorkerProcess) -> None:
        channel = _Channel(self._receive)
        self._transport, _ = await self._loop.create_unix_connection(
            lambda: channel, sock=process.connection
        )
        if self.lost:  # asked to end meanwhile
            self._transport.abort()
        self._transport.writelines(self._unsent)
        self._unsent.clear()
        await channel.ended.wait()
        self._lose()
        await asyncio.to_thread(process.end)

    def _receive(self, answer: Answer) -> None:
        number, outcome, seconds = answer
        self._answered = self._loop.time()
        if number == 0:
            self._come_up()
            return
        waiting = self._waiting.pop(number, None)
        if waiting is None:
            return
        if not waiting.patient:
            queued = max(self._answered - waiting.since - seconds, 0.0)
            self._metrics.worked("stream", queued, seconds)
        waiting.done(outcome)

    def _come_up(self) -> None:
        """Its start is over, one way or the other."""
        if self._deadline is not None:
            self._deadline.cancel()
        self.ready.set()

    def _lose(self) -> None:
        if self.lost:
            return  # asked to end
        log.error("stream worker %s ended: its streams close, clients reconnect", self.pid)
        self.lost = True
        self._metrics.worker_lost("stream")
        self._come_up()
        all_waiting, self._waiting = self._waiting, {}
        for waiting in all_waiting.values():
            waiting.done(Failed(worker_lost()))


def worker_lost() -> WorkerLost:
    """The error that ends the streams of a lost worker."""
    return WorkerLost("the process that computed this stream ended: connect again")


class StreamWorkers:
    """The workers of one service; a lost one is replaced when ``tend`` or the next stream comes.

    Parameters
    ----------
    most : int
        Most processes at a time, retired ones aside.
    metrics : Metrics
        Counts the seconds that each job waited and took, and lost workers.
    """

    def __init__(self, most: int, metrics: Metrics) -> None:
        self._most = most
        self._metrics = metrics
        self.setup: Setup | None = None
        """Settings and models of new workers; set before the first one is needed"""
        self._workers: list[StreamWorker] = []
        self._ending: set[asyncio.Task[None]] = set()

    def assign(self) -> StreamWorker:
        """A place at the worker with the fewest sessions, until ``release``.

        Another worker is started where all have enough.
        """
        current = self._current()
        if len(current) < self._most and all(each.sessions >= ENOUGH for each in current):
            assert self.setup is not None
            current.append(self._started(self.setup))
        worker = min(current, key=lambda each: each.sessions)
        worker.sessions += 1
        return worker

    def release(self, worker: StreamWorker) -> None:
        """Give back the place of a session that has ended."""
        worker.sessions -= 1
        if worker.retired and worker.sessions == 0:
            self._end(worker)

    @property
    def pids(self) -> list[int]:
        """Ids of the running processes."""
        return [worker.pid for worker in self._workers if worker.pid and not worker.lost]

    async def start(self) -> None:
        """Start the first worker and wait until it is ready."""
        worker = self.assign()
        await worker.ready.wait()
        self.release(worker)
        if worker.lost:
            raise WorkerLost("a worker process for streams ended as it started: its log says why")

    @property
    def ready(self) -> bool:
        """Whether one takes sessions now."""
        return any(each.ready.is_set() for each in self._current())

    def tend(self) -> None:
        """Have one that takes sessions."""
        if not self._current():
            assert self.setup is not None
            self._started(self.setup)

    async def renew(self, setup: Setup) -> None:
        """Send new sessions to workers with a new setup; running ones stay where they are.

        Raises
        ------
        WorkerLost
            If no such worker starts; everything then stays as it was.
        """
        worker = self._started(setup)
        worker.retired = True  # takes no sessions until it has started
        await worker.ready.wait()
        if worker.lost:
            raise WorkerLost("a worker process with the new models ended while it started")
        self.setup = setup
        # Only now: streams that came meanwhile may have started further workers.
        old = [each for each in self._workers if not each.retired]
        worker.retired = False
        for each in old:
            each.retired = True
            if each.sessions == 0:
                self._end(each)

    async def stop(self) -> None:
        """End all workers."""
        await asyncio.gather(*(worker.stop() for worker in self._workers), *self._ending)
        self._workers.clear()

    def _current(self) -> list[StreamWorker]:
        """Those that take sessions, or will; lost ones are forgotten."""
        self._workers = [worker for worker in self._workers if not worker.lost]
        return [worker for worker in self._workers if not worker.retired]

    def _started(self, setup: Setup) -> StreamWorker:
        worker = StreamWorker(setup, self._metrics)
        worker.start()
        self._workers.append(worker)
        return worker

    def _end(self, worker: StreamWorker) -> None:
        if worker in self._workers:
            self._workers.remove(worker)
        task = asyncio.get_running_loop().create_task(worker.stop())
        self._ending.add(task)
        task.add_done_callback(self._ending.discard)
