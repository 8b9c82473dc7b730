"""Deadlines and back-pressure of connections.

uvicorn itself waits for ever. Here a request's head has a deadline (slow-loris), and so has data
that a peer does not acknowledge, by the system's own timer. A request's body has one in
``service.api.middleware.body_deadline``, a stream's messages in ``service.streaming.session``.
"""

from __future__ import annotations

import asyncio
import errno
import socket
from contextlib import suppress

import h11
from uvicorn.protocols.http.flow_control import CLOSE_HEADER
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from neuralmusic.errors import ConfigError, RequestTimeout
from service.api.problems import problem_response

HEAD_TIMEOUT_S = 10.0
"""Seconds for a request's head, from the connection or a further request's first byte"""
UNTAKEN_TIMEOUT_S = 20
"""Seconds within which a peer must acknowledge data; behind a cut network, or with a client that
never reads, a socket and its session would else stay for a quarter of an hour or for ever"""

MESSAGES_HELD = 4
"""Queued messages of a stream at which its socket is no longer read"""


class HttpProtocol(H11Protocol):
    """uvicorn's connection, closed where its bytes never become a request."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection and start the deadline of its first request."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        super().data_received(data)
        self._watch()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over; uvicorn would leave an invalid handshake open for ever."""
        super().handle_websocket_upgrade(event)
        taken = self.transport.get_protocol()
        if not getattr(taken, "handshake_initiated", True):
            self.send_400_response("Invalid WebSocket handshake.")

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._unwatch()
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Run the deadline while no request is being answered."""
        answering = self.cycle is not None and not self.cycle.response_complete
        upgraded = self.transport.get_protocol() is not self  # to a WebSocket
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
            self._say_why()
        self.transport.close()

    def _say_why(self) -> None:
        response = problem_response(
            RequestTimeout(f"the request's head did not end within {HEAD_TIMEOUT_S:g} s")
        )
        head = h11.Response(
            status_code=response.status_code,
            headers=[*response.raw_headers, CLOSE_HEADER],
            reason=b"Request Timeout",
        )
        for event in (head, h11.Data(data=bytes(response.body)), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event))


class StreamProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket with back-pressure for clients that send much.

    uvicorn pauses reading after every message until the application has taken it. These two system
    calls are a tenth of what a robot's message costs; this class reads on while few messages wait.
    """

    _heard = 0.0
    """Loop time at which data last arrived"""

    def data_received(self, data: bytes) -> None:
        """Take bytes of a client."""
        self._heard = self.loop.time()
        super().data_received(data)

    def keepalive_timeout(self) -> None:
        """Cut off a client that does not answer a ping, unless its pong may wait behind audio."""
        if self.read_paused or self._heard > self.ping_sent_at:
            self.ping_sent_at = self.loop.time()
            self.pong_timer = self.loop.call_later(self.ping_timeout or 0, self.keepalive_timeout)
        else:
            super().keepalive_timeout()

    def shutdown(self) -> None:
        """Close with the service, unless a close frame was sent and awaits the client's."""
        if not (self.close_sent and self.close_timer):
            super().shutdown()

    def send_receive_event_to_app(self) -> None:
        """Queue a received message."""
        if self.read_paused or self.close_sent:
            super().send_receive_event_to_app()
            return
        self.read_paused = True  # keeps uvicorn from pausing it
        super().send_receive_event_to_app()
        self.read_paused = self.queue.qsize() >= MESSAGES_HELD
        if self.read_paused:
            self.transport.pause_reading()


def check_address(host: str, port: int) -> None:
    """Raise ConfigError unless the service may listen there; it does not yet."""
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise ConfigError(f"host {host} is no address of this machine: {error.strerror}") from None
    for family, kind, protocol, _, place in places:
        with suppress(OSError), socket.socket(family, kind, protocol) as probe:
            # As asyncio binds it later.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            try:
                probe.bind(place)
            except OSError as error:
                if error.errno in (errno.EADDRINUSE, errno.EACCES):
                    raise ConfigError(
                        f"nothing can listen on port {port} of {place[0]} ({error.strerror}): end "
                        "what does, or take another with --port or NEURALMUSIC_PORT"
                    ) from None


def limit_untaken(listening: socket.socket) -> None:
    """End connections whose peer acknowledges nothing (Linux: ``TCP_USER_TIMEOUT``).

    Otherwise asyncio would wait as long as TCP does to send what is left before it closes.
    """
    over_tcp = listening.family in (socket.AF_INET, socket.AF_INET6)
    if over_tcp and hasattr(socket, "TCP_USER_TIMEOUT"):
        timeout_ms = 1000 * UNTAKEN_TIMEOUT_S
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, timeout_ms)
