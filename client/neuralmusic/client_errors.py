"""Errors that end a client's work; the service itself never sends these.

ClientError
├─ ServiceUnreachable
└─ ServiceProblem ─ StreamRefused · StreamClosed
"""

from __future__ import annotations

import json

from typing_extensions import Self

from neuralmusic.errors import DoaError

RETRYABLE_STATUS = frozenset({429, 502, 503, 504})
"""HTTP statuses worth a retry. A proxy answers 502 and 504 for a service that restarts; 429 passes,
as when a robot reconnects before the service notices that its last session is over"""


class ClientError(DoaError, code="client_failed", title="The client cannot go on"):
    """A client of the service cannot go on."""


class ServiceUnreachable(
    ClientError, code="unreachable", title="Service unreachable", retryable=True
):
    """Nothing answers at the address, or not in time."""


class ServiceProblem(ClientError, code="service_problem", title="The service refused"):
    """The service refused: ``code``, ``title`` and ``detail`` are the service's own.

    Parameters
    ----------
    code, title, detail : str
        Fields of the problem document (RFC 9457), or of the stream's ``error`` or ``closing``.
    status : int
        HTTP status, or 0 where a stream was closed instead.
    retryable : bool
        True where the same request may succeed later.
    close_code : int
        WebSocket close code, or 0 where there was none.
    retry_after_s : float, optional
        Seconds that the service asks to wait.
    """

    def __init__(
        self,
        code: str,
        title: str,
        detail: str,
        status: int = 0,
        retryable: bool = False,
        *,
        close_code: int = 0,
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(detail)
        self.code, self.title, self.status = code, title, status
        self.retryable, self.close_code = retryable, close_code
        self.retry_after_s = retry_after_s

    @classmethod
    def answered(
        cls, status: int, reason: str, body: bytes | bytearray, retry_after: str | None
    ) -> Self:
        """The problem of an HTTP answer, whose body is a problem document or a proxy's page.

        A ``Retry-After`` with a date is ignored.
        """
        try:
            problem = json.loads(body)
            code, title, detail = (str(problem[key]) for key in ("code", "title", "detail"))
        except (ValueError, LookupError, TypeError):
            code, title = f"http_{status}", reason or "Refused"
            detail = f"the service answered with HTTP status {status} ({title})"
        wait = float(retry_after) if retry_after and retry_after.strip().isdigit() else None
        return cls(code, title, detail, status, status in RETRYABLE_STATUS, retry_after_s=wait)


class StreamRefused(ServiceProblem, code="stream_refused", title="Stream refused"):
    """The service did not begin the session."""


class StreamClosed(ServiceProblem, code="stream_closed", title="Stream closed"):
    """The session has ended, or cannot be resumed."""
