"""The pool that computes streams: worker processes, each with its share of the sessions."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from neuralmusic.errors import InvalidOption, Overloaded, WorkerLost
from service.observability.metrics import Metrics
from service.streaming.cost import HEAVY_STEP_S, ORDINARY, StreamCost
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
        self.costs: list[StreamCost] = []
        """What the sessions cost that are computed here"""
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
    def sessions(self) -> int:
        """Number of sessions computed here."""
        return len(self.costs)

    @property
    def load(self) -> float:
        """Estimated share of a core that they take."""
        return sum(cost.share for cost in self.costs)

    @property
    def heavy(self) -> bool:
        """Whether one of them is to be kept apart."""
        return any(cost.heavy for cost in self.costs)

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

    def assign(self, cost: StreamCost = ORDINARY) -> StreamWorker:
        """A place for a session at a worker that can carry it, until ``release``.

        Ordinary sessions go where the fewest are; another worker is started where all have enough.
        Heavy ones are kept apart from them, and where there are several workers one is left to the
        ordinary ones.

        Raises
        ------
        InvalidOption
            If no worker can ever carry the session.
        Overloaded
            If none can now.
        """
        self._check_share(cost)
        current = self._current()
        worker = self._heavy_place(current, cost) if cost.heavy else self._place(current)
        if worker is None:
            raise Overloaded(
                f"this stream needs {cost.share:.0%} of a core beside the streams that run: "
                "connect again later, with fewer microphones or a longer output.interval_ms"
            )
        worker.costs.append(cost)
        return worker

    def _place(self, current: list[StreamWorker]) -> StreamWorker | None:
        """A worker for an ordinary session."""
        apart = [each for each in current if not each.heavy]
        if len(current) < self._most and all(each.sessions >= ENOUGH for each in apart):
            return self._started_now()
        beside = [each for each in current if all(c.step_s <= HEAVY_STEP_S for c in each.costs)]
        return min(apart or beside, key=lambda each: each.load, default=None)

    def _heavy_place(self, current: list[StreamWorker], cost: StreamCost) -> StreamWorker | None:
        """A worker for a heavy session, away from ordinary ones where its steps are long."""
        room = [each for each in current if each.load + cost.share <= 1]
        free = self._most == 1 or sum(each.heavy for each in current) < self._most - 1
        for each in room:
            if each.heavy and all(other.heavy for other in each.costs):
                return each
            if free and not each.costs:
                return each
        if free and len(current) < self._most:
            return self._started_now()
        return room[0] if room and cost.step_s <= HEAVY_STEP_S else None

    def _check_share(self, cost: StreamCost) -> None:
        if cost.share > 1:
            raise InvalidOption(
                f"this stream needs {cost.share:.1f} cores, and one is the most that a stream can "
                "have: record at a lower sample rate, map fewer microphones, or lengthen "
                "output.interval_ms"
            )

    def change(self, worker: StreamWorker, before: StreamCost, now: StreamCost) -> None:
        """Note that a session costs something else from now on.

        Raises
        ------
        InvalidOption, Overloaded
            If its worker cannot carry it.
        """
        self._check_share(now)
        others = [*worker.costs]
        others.remove(before)
        crowded = (
            any(not each.heavy for each in others) or worker.load - before.share + now.share > 1
        )
        if now.heavy and others and crowded:
            raise Overloaded(
                f"with this output.interval_ms the stream needs {now.share:.0%} of a core, which "
                "its worker's other streams leave it not: begin another session with it"
            )
        worker.costs.remove(before)
        worker.costs.append(now)

    def release(self, worker: StreamWorker, cost: StreamCost = ORDINARY) -> None:
        """Give back the place of a session that has ended."""
        worker.costs.remove(cost)
        if worker.retired and worker.sessions == 0:
            self._end(worker)

    def _started_now(self) -> StreamWorker:
        assert self.setup is not None
        return self._started(self.setup)

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
            self._started_now()

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
