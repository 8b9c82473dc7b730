"""What a client of the service cannot go on with; the service itself never sends these.

ClientError
├─ ServiceUnreachable
└─ ServiceProblem ─ StreamRefused · StreamClosed
"""

from __future__ import annotations

from service.errors import DoaError


class ClientError(DoaError, code="client_failed", title="The client cannot go on"):
    """A client of the service cannot go on."""


class ServiceUnreachable(
    ClientError, code="unreachable", title="Service unreachable", retryable=True
):
    """Nothing answers at the address, or not in time."""


class ServiceProblem(ClientError, code="service_problem", title="The service refused"):
    """The service said no: ``code``, ``title`` and ``detail`` are the service's own.

    Parameters
    ----------
    code, title, detail : str
        Of the problem document (RFC 9457), or of the stream's ``error`` or ``closing``.
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


class StreamRefused(ServiceProblem, code="stream_refused", title="Stream refused"):
    """The service did not begin the session."""


class StreamClosed(ServiceProblem, code="stream_closed", title="Stream closed"):
    """The session has ended, or cannot be resumed."""
