"""uvicorn's WebSocket for clients that send much, and for those that send what is no message."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode
from websockets.protocol import State

from service.api.stream import FLOOD
from service.connections.allowance import Allowance
from service.connections.places import Places

MESSAGES_HELD = 4
"""Messages that the application has not taken, from which on the socket is not read"""
PAUSE_S = 0.05
"""Shortest pause of a client that sends too much"""
SMALL_BYTES = 1024
"""Bytes below which a fragment costs more than it carries"""
EMPTY_SHARE = 0.1
"""Frames without a message, of all that are allowed a second"""


class StreamProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket, read at a bounded rate and without two system calls a message.

    uvicorn stops reading with every message until the application has taken it: a tenth of what a
    robot's message costs. This one reads on while few wait.
    """

    _heard = 0.0
    """Loop time at which data last arrived"""
    _told = False
    """True once the application knows that frames without messages flood the connection"""

    def __init__(
        self,
        config: Config,
        server_state: Places,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        now, frames_per_s = self.loop.time(), server_state.stream_frames_per_s
        self._frames = Allowance(frames_per_s, 2 * frames_per_s, now)
        self._empty = Allowance(EMPTY_SHARE * frames_per_s, frames_per_s, now)
        """Pings, pongs and small fragments, which a client has no reason to send many of"""
        bytes_per_s = server_state.stream_bytes_per_s
        self._bytes = Allowance(bytes_per_s, bytes_per_s, now)

    def data_received(self, data: bytes) -> None:
        """Take bytes of a client."""
        self._heard = self.loop.time()
        self._bytes.spend(len(data), self._heard)
        super().data_received(data)

    def handle_events(self) -> None:
        """Count the frames that came, then handle them."""
        frames = [event for event in self.conn.events if isinstance(event, Frame)]
        self._frames.spend(len(frames), self._heard)
        self._empty.spend(sum(map(carries_little, frames)), self._heard)
        if self._empty.wait_s() and not self._told:
            self._told = True
            self.queue.put_nowait({"type": "websocket.receive", FLOOD: True})  # type: ignore[arg-type]
        super().handle_events()

    def wait_s(self) -> float:
        """Seconds until the client may send more."""
        wait_s = max(self._frames.wait_s(), self._bytes.wait_s())
        return max(wait_s, PAUSE_S) if wait_s else 0.0

    def expects_more(self) -> bool:
        """Whether the client has yet to say that it closes."""
        return self.conn.state in (State.OPEN, State.CLOSING) and self.conn.close_rcvd is None

    @property
    def idle(self) -> bool:
        """Whether nobody misses it: never."""
        return False

    def keepalive_timeout(self) -> None:
        """Cut off a client that does not answer a ping; not one whose pong waits behind audio."""
        if self.read_paused or self._heard > self.ping_sent_at:
            self.ping_sent_at = self.loop.time()
            self.pong_timer = self.loop.call_later(self.ping_timeout or 0, self.keepalive_timeout)
        else:
            super().keepalive_timeout()

    def shutdown(self) -> None:
        """End with the service; a client that has yet to read its last words answers the close."""
        if not (self.close_sent and self.close_timer):
            super().shutdown()

    def send_receive_event_to_app(self) -> None:
        """Queue a message that came."""
        if self.read_paused or self.close_sent:
            super().send_receive_event_to_app()
            return
        self.read_paused = True  # so that it is not paused in there
        super().send_receive_event_to_app()
        self.read_paused = self.queue.qsize() >= MESSAGES_HELD
        if self.read_paused:
            self.transport.pause_reading()


def carries_little(frame: Frame) -> bool:
    """Whether a frame neither ends a message nor carries much of one."""
    if frame.opcode in (Opcode.PING, Opcode.PONG):
        return True
    return not frame.fin and len(frame.data) < SMALL_BYTES
