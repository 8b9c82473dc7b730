"""WebSocket close codes of ``/stream`` and which of them a client should retry."""

from __future__ import annotations

from enum import IntEnum


class CloseCode(IntEnum):
    """Why a connection ended; an ``error`` or ``closing`` message always precedes the frame."""

    DONE = 1000
    """``stop`` was answered"""
    BINARY_BEFORE_START = 1003
    """Audio came before ``start``"""
    ORIGIN = 1008
    """The page's origin is not on the list"""
    TOO_BIG = 1009
    """A message was larger than 64 KiB"""
    INTERNAL = 1011
    """The service failed"""
    DRAINING = 1012
    """The service is shutting down"""
    OVERLOADED = 1013
    """The service is full"""
    INVALID_MESSAGE = 4400
    """A message was wrong; its ``error`` says what"""
    UNAUTHORIZED = 4401
    """The key is missing or unknown"""
    TIMEOUT = 4408
    """Nothing came, or nothing was read, for too long"""
    SESSION_LIMIT = 4410
    """The session reached its longest duration"""
    TOO_MANY_SESSIONS = 4429
    """This client has too many sessions"""


RETRYABLE = frozenset({1001, 1005, 1006, 1011, 1012, 1013, 1015})
"""Codes after which the same session may succeed later; never 4xxx"""
