"""One WebSocket connection from the handshake to ``ready``; refusals become errors.

Compression stays off: it costs milliseconds per message and hardly shortens audio.
"""

from __future__ import annotations

import asyncio
import os
import socket
from dataclasses import dataclass
from typing import TypeVar

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import (
    ConnectionClosed,
    InvalidHandshake,
    InvalidStatus,
    InvalidURI,
)
from websockets.typing import Subprotocol

from neuralmusic.addresses import authorization
from neuralmusic.client_errors import ServiceProblem, ServiceUnreachable, StreamRefused
from neuralmusic.errors import InvalidOption
from neuralmusic.protocol import SUBPROTOCOL
from neuralmusic.protocol.client_messages import Start
from neuralmusic.protocol.close_codes import RETRYABLE
from neuralmusic.protocol.server_messages import (
    Closing,
    Ready,
    StreamError,
)
from neuralmusic.streams.incoming import Incoming
from neuralmusic.timeout import within

Problem = TypeVar("Problem", bound=ServiceProblem)
CLOSE_S = 0.5
"""Seconds for the service's answer to a close"""
MIN_SEND_BUFFER = 64 * 1024
MAX_SERVER_MESSAGE = 2**20


@dataclass(frozen=True)
class Timeouts:
    """Timeouts for a silent network or service, in seconds."""

    open_s: float = 10.0
    """Seconds for the handshake, and again for ``ready``"""
    close_s: float = 5.0
    ping_interval_s: float = 2.0
    """Seconds between pings of the connection, which notice a vanished service"""
    ping_timeout_s: float = 5.0
    """Seconds without an answer to a ping, or without progress in sending"""


async def open_connection(
    url: str, start: Start, key: str | None, timeouts: Timeouts, send_buffer: int
) -> tuple[ClientConnection, Ready]:
    """Connect, send ``start`` and wait for ``ready``.

    Parameters
    ----------
    url : str
        ``ws://`` or ``wss://``.
    key : str or None
        Key for the header ``Authorization``.
    send_buffer : int
        Most bytes in the operating system's buffer, at least 64 KiB: audio there cannot be dropped
        and becomes stale.

    Raises
    ------
    ServiceUnreachable
        If nothing answers.
    StreamRefused
        If the service refuses.
    InvalidAnswer
        If something else answers.
    """
    try:
        websocket = await connect(
            url,
            subprotocols=[Subprotocol(SUBPROTOCOL)],
            additional_headers=authorization(key),
            compression=None,
            open_timeout=timeouts.open_s,
            close_timeout=timeouts.close_s,
            ping_interval=timeouts.ping_interval_s,
            ping_timeout=timeouts.ping_timeout_s,
            max_size=MAX_SERVER_MESSAGE,
        )
    except InvalidStatus as error:
        response = error.response
        raise StreamRefused.answered(
            response.status_code,
            response.reason_phrase,
            response.body or b"",
            response.headers.get("Retry-After"),
        ) from None
    except InvalidURI as error:
        raise InvalidOption(f"{url} is not an address: {error}") from None
    except (OSError, asyncio.TimeoutError, InvalidHandshake) as error:
        raise _unreachable(url, error, timeouts.open_s) from None
    try:
        return websocket, await _start(websocket, url, start, timeouts, send_buffer)
    except BaseException:
        await close_at_once(websocket)
        raise


async def close_at_once(websocket: ClientConnection) -> None:
    """Close a connection without waiting for further messages."""
    closing = asyncio.ensure_future(websocket.close())
    await asyncio.wait([closing], timeout=CLOSE_S)
    websocket.transport.abort()  # the close of a service that goes on sending takes seconds
    await asyncio.gather(closing, return_exceptions=True)


async def _start(
    websocket: ClientConnection, url: str, start: Start, timeouts: Timeouts, send_buffer: int
) -> Ready:
    if websocket.subprotocol != SUBPROTOCOL:
        raise StreamRefused(
            "protocol_unknown",
            "Unknown protocol",
            f"{url} does not speak {SUBPROTOCOL}: is it this service, in this version?",
        )
    _shrink_send_buffer(websocket, max(send_buffer, MIN_SEND_BUFFER))
    try:
        await websocket.send(start.model_dump_json(exclude_unset=True))
        return await within(timeouts.open_s, _ready(websocket))
    except ConnectionClosed:
        raise closed_by(websocket, None, StreamRefused) from None
    except asyncio.TimeoutError:
        raise ServiceUnreachable(
            f"{url} accepted the connection but did not answer `start` within {timeouts.open_s:g} s"
        ) from None


async def _ready(websocket: ClientConnection) -> Ready:
    """The ``ready`` of the service, or its refusal."""
    said: StreamError | Closing | None = None
    incoming = Incoming()
    try:
        while True:
            message = incoming.read(await websocket.recv())
            if isinstance(message, Ready):
                return message
            if isinstance(message, (StreamError, Closing)):
                said = message
    except ConnectionClosed:
        raise closed_by(websocket, said, StreamRefused) from None


def closed_by(
    websocket: ClientConnection, said: StreamError | Closing | None, kind: type[Problem]
) -> Problem:
    """Why a connection was closed, in the service's words where there are any."""
    code = websocket.close_code or 1006
    retryable = code in RETRYABLE
    if said is not None:
        retryable = retryable or (isinstance(said, StreamError) and said.retryable)
        title = said.title if isinstance(said, StreamError) else "Session ended"
        why = said.code, title, said.detail
    else:
        reason = f" ({websocket.close_reason})" if websocket.close_reason else ""
        name, title, lost = (
            ("connection_lost", "Connection lost", "the connection to the service was lost")
            if code == 1006
            else (f"closed_{code}", "Connection closed", "the service closed")
        )
        why = name, title, f"{lost} without a word, code {code}{reason}"
    return kind(*why, retryable=retryable, close_code=code)


def _unreachable(url: str, error: Exception, timeout_s: float) -> ServiceUnreachable:
    if isinstance(error, asyncio.TimeoutError):
        return ServiceUnreachable(f"{url} did not answer within {timeout_s:g} s")
    if isinstance(error, OSError):
        return ServiceUnreachable.at(url, error, _reason(error))
    return ServiceUnreachable(f"{url} does not answer as a WebSocket: {error}")


def _reason(error: OSError) -> str:
    """The system's reason; asyncio's repeats every address that it tried."""
    if isinstance(error, socket.gaierror) or error.errno is None:
        return error.strerror or "no connection"
    return os.strerror(error.errno).lower()


def _shrink_send_buffer(websocket: ClientConnection, size: int) -> None:
    found = websocket.transport.get_extra_info("socket")
    if found is not None and found.family in (socket.AF_INET, socket.AF_INET6):
        found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size)
