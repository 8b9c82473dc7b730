"""``WS /stream``: one session over one WebSocket; no numerics, no waiting for anybody."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack, suppress

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from service.access.key_file import Key
from service.access.keys import ANYONE
from service.api.middleware.guard import key_of
from service.api.outbox import Outbox, message_json
from service.api.problems import problem_response
from service.api.state import ServiceState
from service.api.stream_watch import StreamWatch
from service.errors import (
    AccessError,
    AudioQuota,
    DoaError,
    StreamTimeout,
    SubprotocolMissing,
    TooManyFrames,
    TooManySessions,
)
from service.machine.memory import give_back_memory
from service.observability.logs import session_id
from service.protocol import SUBPROTOCOL
from service.protocol.close_codes import CloseCode
from service.protocol.server_messages import RESULTS, ServerMessage, Stats
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.session import Session
from service.streaming.work import Close, Outcome
from service.workers.stream_pool import worker_lost

TICK_S = 1.0
"""Seconds between looks at the clock"""
SEND_TIMEOUT_S = 10.0
"""Seconds in which a client must read something"""

FLOOD = "neuralmusic.flood"
"""In what is received where the connection gets frames that hold hardly any messages"""
DROPPABLE = (*RESULTS, Stats)
"""Messages that are about now: old ones make room for new ones"""

router = APIRouter()


@router.websocket("/stream")
async def stream(websocket: WebSocket) -> None:
    """A session after the protocol ``doa.v1``; see docs/protocol.md."""
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
    """Raise whatever refuses this client before the connection is accepted."""
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
        self._worker = state.stream_workers.assign()
        self._streams = state.streams
        self._most = settings.max_sessions_per_client
        self._outbox = Outbox()
        self._sending: float | None = None
        """Since when a message is being sent, by the loop's clock"""
        self._room = asyncio.Event()
        self._room.set()  # the first message has room before anything was pumped
        reporter = self._reporter = Reporter(self._emit)
        ident = self._streams.new_id()
        session_id.set(ident)  # the task is this stream's alone
        self._watch = StreamWatch(state.metrics, reporter.account, self._loop.time)
        self.session = Session(
            ident,
            reporter,
            state.noise,
            SessionLimits(
                settings.stream_buffer_s, settings.idle_timeout_s, settings.max_session_s
            ),
            self._loop.time(),
        )
        self._entry = self._streams.add(self.session, reporter, self.pump)

    async def run(self) -> None:
        """Accept the connection and serve it until either side ends the session."""
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._websocket.accept(subprotocol=SUBPROTOCOL)
            tasks += [asyncio.create_task(each()) for each in (self._read, self._write, self._tick)]
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if any(isinstance(task.exception(), TimeoutError) for task in done):
                self.session.fail(StreamTimeout(f"nothing was read for {SEND_TIMEOUT_S:g} s"))
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.session.abandon()
            # It is closed already, or a client that reads nothing does not take the close either.
            with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await self._websocket.close(CloseCode.TIMEOUT)
            self._worker.submit(Close(self.session.id))
            self._stream_workers.release(self._worker)
            self._streams.end(self._entry)
            if not self._streams.running:
                give_back_memory()
            self._watch.ended(self._entry.client)

    def pump(self) -> None:
        """Hand out the session's next work, make room, close what is closed."""
        work = self.session.take_work()
        if work is not None:
            self._worker.submit(work, self._worked)
        check = self.session.take_check()
        if check is not None:
            self._worker.submit(check, self.session.check_done)
        if self.session.close_code is not None:
            self._outbox.close()
        if self.session.wants_audio:
            self._room.set()
        else:
            self._room.clear()

    def _worked(self, outcome: Outcome) -> None:
        self.session.work_done(outcome, self._loop.time())
        self.pump()

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
            if FLOOD in received:
                self.session.fail(TooManyFrames("too many pings, pongs or small fragments came"))
            now = self._loop.time()
            data, text = received.get("bytes"), received.get("text")
            if data is not None:
                account = self._reporter.account
                audio_s, dropped_s = account.audio_s, account.dropped_s
                self.session.receive_bytes(data, now)
                self._heard(account.audio_s - audio_s, account.dropped_s - dropped_s)
            elif text is not None:
                self.session.receive_text(text, now)
                self._check_client()
            self.pump()

    def _heard(self, audio_s: float, dropped_s: float) -> None:
        """Count the audio of a message, and end the session where the key's is used up."""
        self._watch.heard(audio_s, dropped_s)
        self._keys.charge(self._key, audio_s)
        try:
            self._keys.check_audio(self._key)
        except AudioQuota as error:
            self.session.fail(error)

    def _check_key(self) -> None:
        """End the session where its key is good no more."""
        try:
            self._key = self._keys.check(self._key, "stream")
        except AccessError as error:
            self.session.fail(error)

    def _check_client(self) -> None:
        """One client name may have a bounded number of streams."""
        client = self._entry.client
        if self.session.state != "opening" or client is None:
            return
        if sum(each.client == client for each in self._streams.running_entries()) > self._most:
            self.session.fail(
                TooManySessions(
                    f"the client {client} has {self._most} streams, as many as one may: close "
                    "one, or raise NEURALMUSIC_MAX_SESSIONS_PER_CLIENT"
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
            self.session.tick(now)
            self._check_key()
            self._worker.watch(now)
            if self._worker.lost:  # a stream that is waiting for audio would not notice
                self.session.fail(worker_lost())
            self.pump()
