"""Deadlines of requests, and how fast they are read.

uvicorn itself waits for ever. Here a request's head has a deadline (slow-loris), and so has data
that a peer does not acknowledge, by the system's own timer. A request's body has one in
``service.api.middleware.body_deadline``, a stream's messages in ``service.streaming.session``.
"""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import h11
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import CLOSE_HEADER
from uvicorn.protocols.http.h11_impl import STATUS_PHRASES, H11Protocol
from uvicorn.server import ServerState

from neuralmusic.errors import DoaError, RequestTimeout, TooManyConnections, UploadError
from service.api.problems import problem_response
from service.connections.allowance import Allowance

HEAD_TIMEOUT_S = 10.0
"""Seconds for a request's head, from the connection or a further request's first byte"""
UNTAKEN_TIMEOUT_S = 20
"""Seconds within which a peer must acknowledge data; behind a cut network, or with a client that
never reads, a socket and its session would else stay for a quarter of an hour or for ever"""
HEAD_BYTES = 16 * 2**10
"""Largest head of a request"""
LINES_PER_S = 5000
"""Headers and small chunks of a body per second; each costs as much as a large chunk"""
LINES_BURST = 2000
LINES_PER_REQUEST = 25
"""Lines that cost as much as an answer"""
SMALL_BYTES = 1024
"""Bytes below which a chunk counts as a line"""


class RequestReader(h11.Connection):
    """h11 that counts what costs time, and refuses a request whose end can be read in two ways.

    A proxy that believes the length where this service believes the chunks would let a client hide
    a second request in the first one's body.
    """

    lines = 0
    """Headers, small chunks and requests that were read and are not yet accounted for"""
    wrong = ""
    """What was wrong with the last request"""

    def __init__(self) -> None:
        super().__init__(h11.SERVER, HEAD_BYTES)

    def next_event(self) -> Any:
        """The next event; RemoteProtocolError where there is none to be had."""
        try:
            return self._counted(super().next_event())
        except h11.RemoteProtocolError as error:
            self.wrong = str(error)[:200]
            raise

    def _counted(self, event: Any) -> Any:
        if isinstance(event, h11.Data):
            self.lines += len(event.data) < SMALL_BYTES
        elif isinstance(event, h11.Request):
            self.lines += LINES_PER_REQUEST + len(event.headers)
            if {b"content-length", b"transfer-encoding"} <= {name for name, _ in event.headers}:
                raise h11.RemoteProtocolError("it has both Content-Length and Transfer-Encoding")
        return event


class HttpProtocol(H11Protocol):
    """uvicorn's connection, closed where what comes never becomes a request."""

    _deadline: asyncio.TimerHandle | None = None

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.conn: RequestReader = RequestReader()
        self._lines = Allowance(LINES_PER_S, LINES_BURST, self.loop.time())

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection; its first request is due."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        if self.conn.their_state is h11.DONE and len(self.conn.trailing_data[0]) > HEAD_BYTES:
            # Requests behind one that is being answered: whether its client is still there can
            # only be told by reading on, and what is read has to stay somewhere.
            self.cycle.keep_alive = False
            self.flow.pause_reading()
            return
        super().data_received(data)
        self._lines.spend(self.conn.lines, self.loop.time())
        self.conn.lines = 0
        self._watch()

    def wait_s(self) -> float:
        """Seconds until the client may send more."""
        return self._lines.wait_s()

    def expects_more(self) -> bool:
        """Whether the client is in the midst of a request."""
        return self.conn.their_state in (h11.SEND_BODY, h11.ERROR) or bool(
            self.conn.trailing_data[0]
        )

    @property
    def idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def refuse(self) -> None:
        """Say that there is no place, and close."""
        self._say(TooManyConnections("there are as many connections as may be: try again later"))
        self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no request, unless an answer to it has begun."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            self._say(UploadError(f"{msg} {self.conn.wrong}".strip()))
        if not self.idle:
            self.cycle.disconnected = True  # the application has nothing more to say
        self.transport.close()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over; uvicorn would leave a handshake that is none open for ever."""
        super().handle_websocket_upgrade(event)
        taken = self.transport.get_protocol()
        if not getattr(taken, "handshake_initiated", True):
            self.send_400_response("Invalid WebSocket handshake.")

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._unwatch()
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Let the deadline run while no request is being answered."""
        answering = self.cycle is not None and not self.cycle.response_complete
        upgraded = self.transport.get_protocol() is not self  # to the WebSocket's
        if answering or upgraded:
            self._unwatch()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_TIMEOUT_S, self._too_late)

    def _unwatch(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _too_late(self) -> None:
        self._deadline = None
        begun, _ = self.conn.trailing_data
        if begun and self.conn.our_state is h11.IDLE and not self.transport.is_closing():
            self._say(RequestTimeout(f"the request's head did not end within {HEAD_TIMEOUT_S:g} s"))
        self.transport.close()

    def _say(self, error: DoaError) -> None:
        """Answer before there is a request, or where there never will be one."""
        response = problem_response(error)
        head = h11.Response(
            status_code=response.status_code,
            headers=[*response.raw_headers, CLOSE_HEADER],
            reason=STATUS_PHRASES[response.status_code],
        )
        events = (head, h11.Data(data=bytes(response.body)), h11.EndOfMessage())
        self.transport.write(b"".join(self.conn.send(event) or b"" for event in events))


def limit_untaken(listening: socket.socket) -> None:
    """End this socket's connections where the peer takes nothing (Linux: ``TCP_USER_TIMEOUT``).

    Without it asyncio waits as long as TCP does to send what is left, before it closes.
    """
    over_tcp = listening.family in (socket.AF_INET, socket.AF_INET6)
    if over_tcp and hasattr(socket, "TCP_USER_TIMEOUT"):
        timeout_ms = 1000 * UNTAKEN_TIMEOUT_S
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, timeout_ms)
