"""Metrics and log lines of one stream."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextvars import copy_context
from typing import Any

from neuralmusic.protocol.server_messages import (
    RESULTS,
    Closing,
    OdasSsl,
    Ready,
    ServerMessage,
    StreamError,
    StreamWarning,
)
from service.observability.metrics import Metrics
from service.streaming.account import Account

log = logging.getLogger(__name__)


class StreamWatch:
    """Counts and logs one stream.

    Parameters
    ----------
    account : Account
        The account of the stream's session; it is only read.
    time : callable
        The session's clock, seconds.
    """

    def __init__(self, metrics: Metrics, account: Account, time: Callable[[], float]) -> None:
        self._metrics = metrics
        self._account = account
        self._time = time
        self._context = copy_context()
        """Ids of request, stream and span, which a worker's messages come without"""
        self._reason = "vanished"
        self._detail: str | None = None

    def heard(self, audio_s: float, dropped_s: float) -> None:
        """Count the seconds of audio that a message brought, and those that were dropped."""
        self._metrics.audio("stream", audio_s)
        self._metrics.audio_dropped(dropped_s)

    def said(self, message: ServerMessage, client: str | None) -> float | None:
        """Note a message to the client; return when a result's last audio arrived, or None."""
        if isinstance(message, RESULTS) and not isinstance(message, OdasSsl):  # an sst follows
            lag = self._account.lag_ms / 1000
            self._metrics.lag(lag)
            return self._time() - lag
        if isinstance(message, Ready):
            fields = {
                "client_name": client,
                "array": message.array.name,
                "model": message.model.name if message.model else None,
                "localization": message.method,
            }
            self._log("stream began", fields)
        elif isinstance(message, StreamWarning):
            self._metrics.warned(message.code)
        elif isinstance(message, Closing):
            self._reason = message.code
        elif isinstance(message, StreamError):
            self._reason, self._detail = message.code, message.detail
            self._metrics.refused(message.code)
        return None

    def sent(self, arrived: float | None) -> None:
        """Count a result that was handed to the socket."""
        if arrived is not None:
            self._metrics.result_sent(self._time() - arrived)

    def ended(self, client: str | None) -> None:
        """Count and log the end."""
        account = self._account
        self._metrics.session_ended(self._reason)
        fields = {
            "reason": self._reason,
            "client_name": client,
            "audio_s": round(account.audio_s, 3),
            "dropped_s": round(account.dropped_s, 3),
            "results": account.results,
            "lag_p50_ms": account.median_lag_ms(),
            "lag_max_ms": account.most_lag_ms,
        }
        if self._detail is not None:
            fields["detail"] = self._detail
        self._log(f"stream ended: {self._reason}", fields)

    def _log(self, message: str, fields: Mapping[str, Any]) -> None:
        self._context.run(log.info, message, extra=fields)
