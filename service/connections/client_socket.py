"""What lies between a client's socket and the protocol that is spoken over it.

uvicorn's protocols parse whatever a socket gives, a quarter of a megabyte at a time, and close
sockets with bytes unread, whereupon the system takes back what was said last. Here bytes are handed
on in small pieces, no faster than the protocol allows, and a socket is closed once the client has
had time to read.
"""

from __future__ import annotations

import asyncio
from typing import Any, Protocol, cast

from uvicorn.config import Config

from service.connections.places import Places

PIECE_BYTES = 4096
"""Parsed without looking at the clock: at most 700 frames of a WebSocket"""
TURN_BYTES = 4 * PIECE_BYTES
"""Parsed before others have their turn: with hundreds of uploads, a robot waits for all of them"""
LINGER_S = 30.0
"""Seconds in which a refused client may go on sending before its socket is closed"""
LINGER_BYTES_PER_S = 64 * 2**20
"""Bytes that are thrown away meanwhile"""
QUIET_S = 2.0
"""Seconds without any of them, after which the client has had its time to read"""


class Spoken(Protocol):
    """A protocol of uvicorn's that says how fast it may be read."""

    def wait_s(self) -> float:
        """Seconds until it takes the next piece."""
        ...

    def expects_more(self) -> bool:
        """Whether the client may still be sending when it is closed."""
        ...

    @property
    def idle(self) -> bool:
        """Whether nothing is lost where the connection is closed."""
        ...


class ClientSocket(asyncio.Protocol, asyncio.Transport):
    """The socket's protocol, and the transport of ``spoken``.

    Parameters
    ----------
    spoken : asyncio.Protocol
        Has the methods of ``Spoken``, too.
    """

    def __init__(self, spoken: asyncio.Protocol, places: Places) -> None:
        super().__init__()
        self._spoken = spoken
        self._places = places
        self._loop = asyncio.get_running_loop()
        self._socket: asyncio.Transport = None  # type: ignore[assignment]
        self._unread = bytearray()
        self._held = False
        """The protocol wants nothing for now"""
        self._waiting: asyncio.Handle | None = None
        """For the time of the next piece"""
        self._closed = False
        self._parted = False
        """``spoken`` knows that the connection is over"""
        self._lingers_until = 0.0
        self._discarded = 0

    # The socket's protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection, or refuse it where there is no place."""
        self._socket = cast(asyncio.Transport, transport)
        fits = self._places.enter(self)
        self._spoken.connection_made(self)
        if not fits:
            self._spoken.refuse()  # type: ignore[attr-defined]

    def data_received(self, data: bytes) -> None:
        """Take bytes of the client's."""
        if self._closed:
            self._discarded += len(data)
            self._socket.pause_reading()
            self._loop.call_later(len(data) / LINGER_BYTES_PER_S, self._socket.resume_reading)
            return
        self._unread += data
        if self._waiting is None:
            self._hand_on()

    def eof_received(self) -> bool | None:
        """Note that the client sends no more."""
        return None if self._closed else self._spoken.eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._places.leave(self)
        self._closed = True
        if self._waiting is not None:
            self._waiting.cancel()
        self._part(exc)

    def pause_writing(self) -> None:
        """Tell the protocol that the client does not read."""
        self._spoken.pause_writing()

    def resume_writing(self) -> None:
        """Tell the protocol that it reads again."""
        self._spoken.resume_writing()

    # A guest among others

    @property
    def address(self) -> str:
        """The peer's."""
        peer = self._socket.get_extra_info("peername")
        return str(peer[0]) if isinstance(peer, tuple) else ""

    @property
    def idle(self) -> bool:
        """Whether it may be closed for another one."""
        return self._closed or cast(Spoken, self._spoken).idle

    def leave(self) -> None:
        """Close at once."""
        self._closed = True
        self._socket.abort()

    # The protocol's transport

    def close(self) -> None:
        """Close once what was said is sent, and read where the client may still be sending."""
        if self._closed:
            return
        self._closed = True
        if self._socket.is_closing() or not (
            self._unread or cast(Spoken, self._spoken).expects_more()
        ):
            self._socket.close()
            return
        # A socket that is closed with bytes unread is reset, and takes its last words with it.
        self._unread.clear()
        self._socket.write_eof()
        self._lingers_until = self._loop.time() + LINGER_S
        self._socket.resume_reading()
        self._loop.call_soon(self._part, None)
        self._linger(-1)

    def abort(self) -> None:
        """Close at once."""
        self.leave()

    def is_closing(self) -> bool:
        """Whether it is closed for the protocol."""
        return self._closed or self._socket.is_closing()

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Speak another protocol from now on."""
        self._spoken = cast(asyncio.Protocol, protocol)

    def get_protocol(self) -> asyncio.BaseProtocol:
        """The one that is spoken."""
        return self._spoken

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """The socket's."""
        return self._socket.get_extra_info(name, default)

    def write(self, data: Any) -> None:
        """Send bytes, unless it is closed."""
        if not self._closed:
            self._socket.write(data)

    def pause_reading(self) -> None:
        """Hand on nothing for now."""
        self._held = True
        self._socket.pause_reading()

    def resume_reading(self) -> None:
        """Hand on what comes."""
        self._held = False
        if self._closed:
            return
        if self._waiting is None and self._unread:
            self._waiting = self._loop.call_soon(self._go_on)
        elif self._waiting is None:
            self._socket.resume_reading()

    def _go_on(self) -> None:
        self._waiting = None
        self._hand_on()

    def _hand_on(self) -> None:
        """Hand on what came, until the protocol has had enough or it is others' turn."""
        turn = len(self._unread) - TURN_BYTES
        while self._unread and not (self._held or self._closed):
            if len(self._unread) <= turn:
                self._waiting = self._loop.call_soon(self._go_on)
                break
            piece = bytes(self._unread[:PIECE_BYTES])
            del self._unread[:PIECE_BYTES]
            self._spoken.data_received(piece)
            wait_s = cast(Spoken, self._spoken).wait_s()
            if wait_s and not self._closed:
                self._waiting = self._loop.call_later(wait_s, self._go_on)
                break
        if self._closed:
            return
        if self._unread or self._held or self._waiting:
            self._socket.pause_reading()
        else:
            self._socket.resume_reading()

    def _linger(self, discarded: int) -> None:
        """Throw away what comes until the client falls silent or its time is over."""
        if discarded == self._discarded or self._loop.time() >= self._lingers_until:
            self._socket.close()
            return
        self._waiting = self._loop.call_later(QUIET_S, self._linger, self._discarded)

    def _part(self, exc: Exception | None) -> None:
        """Tell the protocol that the connection is over, once."""
        if not self._parted:
            self._parted = True
            self._spoken.connection_lost(exc)


class Reception:
    """Makes the protocol of every new connection; uvicorn takes it for a protocol's class.

    Parameters
    ----------
    spoken : callable
        The class of protocols that a connection begins with.
    """

    def __init__(self, spoken: type[asyncio.Protocol]) -> None:
        self._spoken = spoken

    def __call__(
        self,
        config: Config,
        server_state: Places,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> ClientSocket:
        """The protocol of a socket that was accepted."""
        spoken = self._spoken(config, server_state, app_state, _loop)  # type: ignore[call-arg]
        return ClientSocket(spoken, server_state)
