"""Errors that end a client's work; the service itself never sends these.

ClientError
├─ ServiceUnreachable
├─ InvalidAnswer
└─ ServiceProblem ─ StreamRefused · StreamClosed
"""

from __future__ import annotations

import json
import re
import ssl
from typing import Optional
from urllib.parse import urlsplit

from typing_extensions import Self

from neuralmusic.errors import DoaError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
LONGEST_WAIT_S = 3600.0
"""Most seconds that a service's ``Retry-After`` is believed"""
RETRYABLE_STATUS = frozenset({429, 502, 503, 504})
"""HTTP statuses worth a retry. A proxy answers 502 and 504 for a service that restarts; 429 passes,
as when a robot reconnects before the service notices that its last session is over"""


class ClientError(DoaError, code="client_failed", title="The client cannot go on"):
    """A client of the service cannot go on."""


class ServiceUnreachable(
    ClientError, code="unreachable", title="Service unreachable", retryable=True
):
    """Nothing answers at the address, or not in time."""

    @classmethod
    def at(cls, url: str, error: Exception, reason: str) -> Self:
        """The error of a connection that cannot be made, with what to look at.

        Parameters
        ----------
        url : str
            Address that was tried.
        error : Exception
            What the HTTP or WebSocket library raised.
        reason : str
            The library's or the system's words for it.
        """
        tls = _tls_error(error)
        if isinstance(tls, ssl.SSLCertVerificationError):
            return cls(f"the certificate of {url} is not trusted ({tls.verify_message})")
        if tls is not None:
            return cls(
                f"{url} answers, but not with TLS: use http:// or ws://, or the proxy's address"
            )
        network = "" if urlsplit(url).hostname in LOOPBACK else ", and listening on the network"
        start = "neuralmusic serve" if not network else "NEURALMUSIC_HOST=0.0.0.0 neuralmusic serve"
        return cls(
            f"nothing answers at {url} ({reason}): is the service running there{network} ({start})?"
        )


class InvalidAnswer(ClientError, code="answer_invalid", title="Invalid answer"):
    """What answers does not answer as this service does, or without end."""


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

        A ``Retry-After`` that is no number of seconds is ignored.
        """
        try:
            problem = json.loads(body)
            code, title, detail = (str(problem[key]) for key in ("code", "title", "detail"))
        except (ValueError, LookupError, TypeError, RecursionError):
            code, title = f"http_{status}", reason or "Refused"
            detail = f"the service answered with HTTP status {status} ({title})"
        wait = None
        if re.fullmatch("[0-9]+", retry_after or "", re.ASCII):
            wait = min(float(str(retry_after)[:12]), LONGEST_WAIT_S)
        return cls(code, title, detail, status, status in RETRYABLE_STATUS, retry_after_s=wait)


class StreamRefused(ServiceProblem, code="stream_refused", title="Stream refused"):
    """The service did not begin the session."""


class StreamClosed(ServiceProblem, code="stream_closed", title="Stream closed"):
    """The session has ended, or cannot be resumed."""


def _tls_error(error: Optional[BaseException]) -> Optional[ssl.SSLError]:
    """The TLS failure behind an error, if there is one."""
    while error is not None:
        if isinstance(error, ssl.SSLError):
            return error
        error = error.__cause__ or error.__context__
    return None
