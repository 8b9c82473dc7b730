"""``WS /stream``: one session over one WebSocket; no numerics, nothing that blocks the loop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from functools import partial

import anyio.to_thread
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from starlette.types import Message

from neuralmusic.errors import (
    UNEXPECTED,
    AccessError,
    AudioQuota,
    DoaError,
    InvalidOption,
    Overloaded,
    StreamTimeout,
    SubprotocolMissing,
    TooManyFrames,
    TooManySessions,
)
from neuralmusic.protocol import SUBPROTOCOL
from neuralmusic.protocol.close_codes import CloseCode
from neuralmusic.protocol.server_messages import RESULTS, ServerMessage, Stats
from service.access.key_file import Key
from service.access.keys import ANYONE
from service.api.middleware.guard import key_of
from service.api.outbox import Outbox, message_json
from service.api.problems import problem_response
from service.api.state import ServiceState
from service.api.stream_watch import StreamWatch
from service.observability.logs import session_id
from service.streaming.calibrations import keep, with_noise
from service.streaming.cost import StreamCost, stream_cost
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.session import Session
from service.streaming.work import Close, Failed, Keep, Open, Outcome, Work
from service.workers.stream_pool import StreamWorker, worker_lost

log = logging.getLogger(__name__)

TICK_S = 1.0
"""Seconds between ticks of a session"""
SEND_TIMEOUT_S = 10.0
"""Seconds within which a client must read something"""

FLOOD = "neuralmusic.flood"
"""Key of a received message, set where frames without messages flood the connection"""
DROPPABLE = (*RESULTS, Stats)
"""Messages that describe the present: old ones make room for new ones"""

router = APIRouter()


@router.websocket("/stream")
async def stream(websocket: WebSocket) -> None:
    """A session by the protocol ``doa.v1``; see docs/protocol.md."""
    state: ServiceState = websocket.app.state.service
    key = key_of(websocket)
    with ExitStack() as held:
        try:
            _check_handshake(websocket, state)
            held.enter_context(state.keys.session(key))
            # It takes its place before it is accepted, so that two cannot take the last one.
            connection = Connection(websocket, state, key)
        except DoaError as error:
            await websocket.send_denial_response(problem_response(error))
            return
        await connection.run()


def _check_handshake(websocket: WebSocket, state: ServiceState) -> None:
    """Raise the error that refuses this client before the connection is accepted."""
    if SUBPROTOCOL not in websocket.scope["subprotocols"]:
        raise SubprotocolMissing(
            f"/stream speaks the WebSocket subprotocol {SUBPROTOCOL}: offer it"
        )
    state.admit()
    state.streams.check()


class Connection:
    """Moves messages between a WebSocket, a session and the worker that computes it."""

    def __init__(self, websocket: WebSocket, state: ServiceState, key: Key = ANYONE) -> None:
        settings = state.settings
        self._websocket = websocket
        self._keys = state.keys
        self._key = key
        self._loop = asyncio.get_running_loop()
        self._stream_workers = state.stream_workers
        self._worker: StreamWorker | None = None
        """The worker that computes the session, from its ``start`` on"""
        self._cost: StreamCost | None = None
        self._interval_ms = 0
        self._streams = state.streams
        self._noise = state.noise
        self._noise_access = state.noise_access
        self._storing: asyncio.Task[None] | None = None
        """The session's job that waits for the store of noise profiles"""
        self._most = settings.max_sessions_per_client
        self._outbox = Outbox()
        self._broken = False
        """The session's code has raised: it is called no more"""
        self._sending: float | None = None
        """Loop time at which the message being sent began"""
        self._room = asyncio.Event()
        self._room.set()  # there is room for the first message before the first pump
        reporter = self._reporter = Reporter(self._emit)
        ident = self._streams.new_id()
        session_id.set(ident)  # the task is this stream's alone
        self._watch = StreamWatch(state.metrics, reporter.account, self._loop.time)
        self.session = Session(
            ident,
            reporter,
            SessionLimits(
                settings.stream_buffer_s, settings.idle_timeout_s, settings.max_session_s
            ),
            self._loop.time(),
        )
        self._entry = self._streams.add(self.session, reporter, self.act)

    async def run(self) -> None:
        """Accept the connection and serve it until either side ends the session."""
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._websocket.accept(subprotocol=SUBPROTOCOL)
            tasks += [asyncio.create_task(each()) for each in (self._read, self._write, self._tick)]
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            self.act(partial(self._ended, done))
        finally:
            if self._storing is not None:
                tasks.append(self._storing)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.act(self.session.abandon)
            # It is closed already, or a client that reads nothing does not take the close either.
            with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await self._websocket.close(self.session.close_code or CloseCode.TIMEOUT)
            if self._worker is not None and self._cost is not None:
                self._worker.submit(Close(self.session.id))
                self._stream_workers.release(self._worker, self._cost)
            self._streams.end(self._entry)
            self._watch.ended(self._entry.client)

    def act(self, step: Callable[[], None]) -> None:
        """Have the session take a step, then do what follows from it.

        Whatever that raises is this session's defect and its end. It goes no further: a worker's
        answers, the drain and the clock have other sessions to tell.
        """
        if self._broken:
            return
        try:
            step()
            self._pump()
        except Exception:
            self._broken = True
            log.exception("the stream failed", extra={"session_id": self.session.id})
            with suppress(Exception):  # the same again, where it cannot be told either
                self.session.fail(DoaError(UNEXPECTED))
            self._outbox.close()
            self._room.set()

    def _ended(self, tasks: Iterable[asyncio.Task[None]]) -> None:
        """Take in how reading, writing or looking came to its end."""
        for task in tasks:
            with suppress(RuntimeError, WebSocketDisconnect):  # the client is gone
                try:
                    task.result()
                except TimeoutError:
                    self.session.fail(
                        StreamTimeout(f"the client read nothing in {SEND_TIMEOUT_S:g} s")
                    )

    def _pump(self) -> None:
        """Hand out the session's next work, make room, close what is closed."""
        work = self.session.take_work()
        if work is not None:
            self._assign()
        if self.session.close_code is not None:
            pass  # no worker could carry it
        elif isinstance(work, Open | Keep):
            self._storing = asyncio.create_task(self._store(work))
        elif work is not None:
            self._submit(work, self._worked)
        check = self.session.take_check()
        if check is not None:
            self._submit(check, self._checked)
        if self.session.close_code is not None:
            self._outbox.close()
        if self.session.wants_audio:
            self._room.set()
        else:
            self._room.clear()

    def _assign(self) -> None:
        """Have a worker that can carry the session, also where its interval has changed."""
        start, interval_ms = self.session.start, self.session.output.interval_ms
        if start is None or interval_ms == self._interval_ms:
            return
        cost = stream_cost(start, interval_ms)
        try:
            if self._worker is None or self._cost is None:
                self._worker = self._stream_workers.assign(cost)
            else:
                self._stream_workers.change(self._worker, self._cost, cost)
        except (InvalidOption, Overloaded) as error:
            self.session.fail(error)
        else:
            self._cost, self._interval_ms = cost, interval_ms

    def _submit(self, work: Work, done: Callable[[Outcome], None]) -> None:
        assert self._worker is not None
        self._worker.submit(work, done)

    async def _store(self, work: Open | Keep) -> None:
        """Do what needs the store of noise profiles in a thread: it may wait for a disk."""
        in_thread = partial(anyio.to_thread.run_sync, limiter=self._noise_access)
        try:
            if isinstance(work, Keep):
                self._worked(await in_thread(keep, work, self._noise))
            else:
                found = await in_thread(with_noise, work, self._noise)
                self._submit(found, self._worked)
        except Exception:
            log.exception("the stream failed")
            self._worked(Failed(DoaError(UNEXPECTED)))

    def _worked(self, outcome: Outcome) -> None:
        self.act(lambda: self.session.work_done(outcome, self._loop.time()))

    def _checked(self, outcome: Outcome) -> None:
        self.act(lambda: self.session.check_done(outcome))

    def _emit(self, message: ServerMessage) -> None:
        text = message_json(message, spectrum="spectrum" in self.session.output.include)
        arrived = self._watch.said(message, self._entry.client)
        dropped = self._outbox.put(text, droppable=isinstance(message, DROPPABLE), arrived=arrived)
        self._reporter.account.results_dropped += dropped
        self._entry.observe(message)

    async def _read(self) -> None:
        while True:
            await self._room.wait()
            try:
                received = await self._websocket.receive()
            except RuntimeError:  # starlette's, after the disconnect was received
                return
            if received["type"] == "websocket.disconnect":
                return
            self.act(partial(self._received, received))

    def _received(self, message: Message) -> None:
        """Take a message of the client's."""
        if FLOOD in message:
            self.session.fail(TooManyFrames("too many pings, pongs or small fragments came"))
        now = self._loop.time()
        data, text = message.get("bytes"), message.get("text")
        if data is not None:
            account = self._reporter.account
            audio_s, dropped_s = account.audio_s, account.dropped_s
            self.session.receive_bytes(data, now)
            self._heard(account.audio_s - audio_s, account.dropped_s - dropped_s)
        elif text is not None:
            self.session.receive_text(text, now)
            self._check_client()

    def _heard(self, audio_s: float, dropped_s: float) -> None:
        """Count the audio of a message; end the session where the key's audio is used up."""
        self._watch.heard(audio_s, dropped_s)
        self._keys.charge(self._key, audio_s)
        try:
            self._keys.check_audio(self._key)
        except AudioQuota as error:
            self.session.fail(error)

    def _check_key(self) -> None:
        """End the session where its key no longer allows it."""
        try:
            self._key = self._keys.check(self._key, "stream")
        except AccessError as error:
            self.session.fail(error)

    def _check_client(self) -> None:
        """Raise TooManySessions where this client's name has its most streams."""
        client = self._entry.client
        if self.session.state != "opening" or client is None:
            return
        if sum(each.client == client for each in self._streams.running_entries()) > self._most:
            self.session.fail(
                TooManySessions(
                    f"the client {client} has reached its limit of {self._most} streams: close one"
                )
            )

    async def _write(self) -> None:
        while (message := await self._outbox.get()) is not None:
            self._sending = self._loop.time()
            await self._websocket.send_text(message.text)
            self._sending = None
            self._watch.sent(message.arrived)
        assert self.session.close_code is not None
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await self._websocket.close(self.session.close_code)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            now = self._loop.time()
            if self._sending is not None and now - self._sending > SEND_TIMEOUT_S:
                raise TimeoutError  # nothing more could be said to a client that reads nothing
            if self._worker is not None:
                self._worker.watch(now)
            self.act(partial(self._look, now))

    def _look(self, now: float) -> None:
        """End the session where its time is over, its key is good no more or its worker is gone."""
        self.session.tick(now)
        self._check_key()
        if (
            self._worker is not None and self._worker.lost
        ):  # a stream that is waiting for audio would not notice
            self.session.fail(worker_lost())
