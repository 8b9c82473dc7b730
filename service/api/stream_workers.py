"""Where streams are computed: worker processes, each with its share of the sessions."""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import count

from service.errors import WorkerLost
from service.settings import Settings
from service.stream_worker import HEADER, packed
from service.streaming.work import Failed, Outcome, Work

log = logging.getLogger(__name__)

Done = Callable[[Outcome], None]
ENOUGH = 4
"""Sessions of every worker from which on another one is started: it takes 150 MB and a second"""
END_S = 5.0
"""Seconds that a worker has to end before it is killed"""


class StreamWorker:
    """One worker process and the socket to it; used on the event loop alone."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._numbers = count(1)
        self._waiting: dict[int, Done] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._reading: asyncio.Task[None] | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._unsent: list[bytes] = []
        self.sessions = 0
        """That are computed here"""
        self.lost = False
        self.ready = asyncio.Event()

    def start(self) -> None:
        """Start the process; work may be submitted at once."""
        ours, theirs = socket.socketpair()
        environment = {
            **os.environ,
            # One stream's matrices are small: threads of the linear algebra only cost.
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        }
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "service.stream_worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env=environment,
            )
        self._unsent.insert(0, packed(self._settings))
        self._reading = asyncio.get_running_loop().create_task(self._read(ours))

    def submit(self, work: Work, done: Done | None = None) -> None:
        """Have work done; ``done`` is called with what came of it."""
        number = next(self._numbers)
        if self.lost:
            if done is not None:
                asyncio.get_running_loop().call_soon(done, _failed())
            return
        if done is not None:
            self._waiting[number] = done
        message = packed((number, work))
        if self._writer is None:
            self._unsent.append(message)
        else:
            self._writer.write(message)

    @property
    def pid(self) -> int | None:
        """Of the process, once it was started."""
        return self._process.pid if self._process else None

    async def stop(self) -> None:
        """End the process."""
        self.lost = True
        if self._writer is not None:
            self._writer.close()
        if self._reading is not None:
            await asyncio.gather(self._reading, return_exceptions=True)

    async def _read(self, connection: socket.socket) -> None:
        reader, self._writer = await asyncio.open_unix_connection(sock=connection)
        self._writer.writelines(self._unsent)
        self._unsent.clear()
        try:
            while not self.lost:
                (length,) = HEADER.unpack(await reader.readexactly(HEADER.size))
                number, outcome = pickle.loads(await reader.readexactly(length))
                if number == 0:
                    self.ready.set()
                    continue
                done = self._waiting.pop(number, None)
                if done is not None:
                    done(outcome)
        except (asyncio.IncompleteReadError, OSError):
            self._lose()
        finally:
            self._writer.close()
            with suppress(OSError):
                await self._writer.wait_closed()
            if self._process is not None:
                await asyncio.to_thread(_end, self._process)

    def _lose(self) -> None:
        if self.lost:
            return  # it was asked to end
        log.error("stream worker %s ended: its streams are closed, clients connect again", self.pid)
        self.lost = True
        self.ready.set()
        waiting, self._waiting = self._waiting, {}
        for done in waiting.values():
            done(_failed())


def _failed() -> Failed:
    return Failed(WorkerLost("the process that computed this stream ended: connect again"))


def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process whose socket was closed."""
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class StreamWorkers:
    """The workers of one service; a lost one is replaced when the next stream comes."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._workers: list[StreamWorker] = []

    def assign(self) -> StreamWorker:
        """The worker with the fewest sessions; another one is started where all have enough."""
        self._workers = [worker for worker in self._workers if not worker.lost]
        enough = all(worker.sessions >= ENOUGH for worker in self._workers)
        if enough and len(self._workers) < self._settings.stream_workers:
            worker = StreamWorker(self._settings)
            worker.start()
            self._workers.append(worker)
        return min(self._workers, key=lambda each: each.sessions)

    @property
    def pids(self) -> list[int]:
        """Of the running processes."""
        return [worker.pid for worker in self._workers if worker.pid and not worker.lost]

    async def start(self) -> None:
        """Start the first worker and wait until it is ready."""
        await self.assign().ready.wait()

    async def stop(self) -> None:
        """End all workers."""
        await asyncio.gather(*(worker.stop() for worker in self._workers))
        self._workers.clear()
