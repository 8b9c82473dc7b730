"""``WS /stream``: one session over one WebSocket; no numerics, no waiting for anybody."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from contextlib import suppress
from functools import partial

from fastapi import APIRouter, WebSocket

from service.api.origins import check_origin
from service.api.outbox import Outbox, message_json
from service.api.problems import problem_response
from service.api.state import ServiceState
from service.errors import DoaError, SubprotocolMissing, TooManySessions
from service.protocol import SUBPROTOCOL
from service.protocol.client_messages import Start
from service.protocol.server_messages import OdasSsl, OdasSst, Result, ServerMessage, Stats
from service.streaming.opening import OpenedStream, open_stream
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.session import Session

TICK_S = 1.0
"""Seconds between looks at the clock"""
SEND_TIMEOUT_S = 10.0
"""Seconds in which a client must read something"""

DROPPABLE = (Result, OdasSsl, OdasSst, Stats)
"""Messages that are about now: old ones make room for new ones"""

router = APIRouter()


@router.websocket("/stream")
async def stream(websocket: WebSocket) -> None:
    """A session after the protocol ``doa.v1``; see docs/protocol.md."""
    state: ServiceState = websocket.app.state.service
    try:
        _check_handshake(websocket, state)
    except DoaError as error:
        await websocket.send_denial_response(problem_response(error))
        return
    await websocket.accept(subprotocol=SUBPROTOCOL)
    await Connection(websocket, state).run()


def _check_handshake(websocket: WebSocket, state: ServiceState) -> None:
    """Raise whatever refuses this client before the connection is accepted."""
    check_origin(websocket.headers, state.settings.origins)
    if SUBPROTOCOL not in websocket.scope["subprotocols"]:
        raise SubprotocolMissing(
            f"/stream speaks the WebSocket subprotocol {SUBPROTOCOL}: offer it"
        )
    state.admit()
    state.streams.check()


def _open(start: Start, state: ServiceState) -> OpenedStream:
    """Open a stream unless its client has too many."""
    most = state.settings.max_sessions_per_client
    named = [each for each in state.streams.entries() if each.client == start.client]
    if start.client is not None and len(named) > most:
        raise TooManySessions(
            f"the client {start.client} has {most} streams, as many as one may: close one, or "
            "raise NEURALMUSIC_MAX_SESSIONS_PER_CLIENT"
        )
    return open_stream(start, state.models(), state.noise)


class Connection:
    """Moves messages between a WebSocket, a session and the worker threads."""

    def __init__(self, websocket: WebSocket, state: ServiceState) -> None:
        settings = state.settings
        self._websocket = websocket
        self._loop = asyncio.get_running_loop()
        self._pool, self._check_pool = state.stream_pool, state.check_pool
        self._streams = state.streams
        self._outbox = Outbox()
        self._room = asyncio.Event()
        self._room.set()  # the first message has room before anything was pumped
        reporter = self._reporter = Reporter(self._emit)
        self.session = Session(
            self._streams.new_id(),
            partial(_open, state=state),
            reporter,
            SessionLimits(settings.stream_buffer, settings.idle_timeout, settings.max_session),
            self._loop.time(),
        )
        self._entry = self._streams.add(self.session, reporter, self.pump)

    async def run(self) -> None:
        """Serve until either side ends the session."""
        tasks = [asyncio.create_task(each()) for each in (self._read, self._write, self._tick)]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.session.abandon()
            self._streams.end(self._entry)

    def pump(self) -> None:
        """Hand out the session's next work, make room, close what is closed."""
        work = self.session.take_work()
        if work is not None:
            # Straight to the loop: an asyncio future in between costs more than the rest of this.
            self._pool.submit(work).add_done_callback(self._notify)
        check = self.session.take_check()
        if check is not None:
            self._check_pool.submit(check).add_done_callback(self._notify_checked)
        if self.session.close_code is not None:
            self._outbox.close()
        if self.session.wants_audio:
            self._room.set()
        else:
            self._room.clear()

    def _notify(self, _: Future[None]) -> None:
        """Called in the thread that did the work."""
        with suppress(RuntimeError):  # the loop was closed meanwhile
            self._loop.call_soon_threadsafe(self._worked)

    def _notify_checked(self, _: Future[None]) -> None:
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self.session.check_done)

    def _worked(self) -> None:
        self.session.work_done(self._loop.time())
        self.pump()

    def _emit(self, message: ServerMessage) -> None:
        if self.session.start is None or not isinstance(message, Result):
            text = message_json(message)
        else:
            text = message_json(message, spectrum="spectrum" in self.session.output.include)
        dropped = self._outbox.put(text, droppable=isinstance(message, DROPPABLE))
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
            now = self._loop.time()
            data, text = received.get("bytes"), received.get("text")
            if data is not None:
                self.session.receive_bytes(data, now)
            elif text is not None:
                self.session.receive_text(text, now)
            self.pump()

    async def _write(self) -> None:
        while (text := await self._outbox.get()) is not None:
            # A client that reads nothing is cut off; nothing more could be said to it.
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await self._websocket.send_text(text)
        assert self.session.close_code is not None
        await self._websocket.close(self.session.close_code)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self.session.tick(self._loop.time())
            self.pump()
