"""Streams whose client broke the protocol or met a limit."""

from __future__ import annotations

from service.errors.base import DoaError


class StreamProtocolError(DoaError):
    """A stream's client broke the protocol, or the session met one of its limits."""

    code, status, title = "stream_invalid", 400, "Invalid stream"
    close_code = 4400


class InvalidMessage(StreamProtocolError):
    """A message is no JSON, of no known type, or one of its fields is wrong."""

    code, title = "message_invalid", "Invalid message"


class SubprotocolMissing(StreamProtocolError):
    """The WebSocket's client did not offer the subprotocol ``doa.v1``."""

    code, title = "subprotocol_missing", "Subprotocol missing"


class AudioBeforeStart(StreamProtocolError):
    """Audio came before the message ``start``."""

    code, title, close_code = "audio_before_start", "Audio before start", 1003


class MessageTooBig(StreamProtocolError):
    """A message is larger than 64 KiB."""

    code, title, close_code = "message_too_big", "Message too big", 1009


class StreamTimeout(StreamProtocolError):
    """Nothing came, or nothing was read, for too long."""

    code, title, close_code = "timeout", "Timeout", 4408


class SessionLimit(StreamProtocolError):
    """The session reached its longest duration."""

    code, title, close_code = "session_limit", "Session limit", 4410


class TooManySessions(StreamProtocolError):
    """This client, or this key, has as many sessions as it may have."""

    code, status, title, close_code = "too_many_sessions", 429, "Too many sessions", 4429
