"""WebSocket close codes of ``/stream`` and which of them a client should retry.

An ``error`` or ``closing`` message precedes every close frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum


class CloseCode(IntEnum):
    """Why a connection ended; ``REASONS`` has the words."""

    DONE = 1000
    BINARY_BEFORE_START = 1003
    POLICY = 1008
    TOO_BIG = 1009
    INTERNAL = 1011
    DRAINING = 1012
    OVERLOADED = 1013
    INVALID_MESSAGE = 4400
    UNAUTHORIZED = 4401
    TIMEOUT = 4408
    SESSION_LIMIT = 4410
    TOO_MANY_SESSIONS = 4429


REASONS: Mapping[CloseCode, str] = {
    CloseCode.DONE: "`stop` was answered",
    CloseCode.BINARY_BEFORE_START: "audio came before `start`",
    CloseCode.POLICY: "many pings, pongs or small fragments came, and hardly any messages",
    CloseCode.TOO_BIG: "a message was larger than 256 KiB, or a text longer than 64 KiB",
    CloseCode.INTERNAL: "the service failed, or the client answered no ping and sent nothing",
    CloseCode.DRAINING: "the service is shutting down",
    CloseCode.OVERLOADED: "no worker has room for what this stream costs",
    CloseCode.INVALID_MESSAGE: "a message was wrong; its `error` says what",
    CloseCode.UNAUTHORIZED: "the key was removed, has expired or lost its role",
    CloseCode.TIMEOUT: "nothing came, or nothing was read, for too long",
    CloseCode.SESSION_LIMIT: "the session reached its longest duration",
    CloseCode.TOO_MANY_SESSIONS: "this client has too many sessions, or its key's audio is used up",
}

RETRYABLE = frozenset({1001, 1005, 1006, 1011, 1012, 1013, 1015, 4408, 4410})
"""Codes after which another session may succeed"""
