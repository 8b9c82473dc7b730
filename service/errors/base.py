"""The root of the error tree."""

from __future__ import annotations

UNEXPECTED = "the service failed; its log says why: please report it"
"""Of errors that nobody foresaw; their cause stays in the log"""


class DoaError(Exception):
    """Anything the service can say no to: a stable code, an HTTP status and a sentence.

    A stream that ends with it closes with ``close_code`` (``service.protocol.close_codes``).
    """

    code: str = "internal"
    status: int = 500
    title: str = "Internal error"
    retryable: bool = False
    close_code: int = 1011
    retry_after_s: float | None = None
    """Seconds after which the same request passes, where that is known"""

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class ConfigError(DoaError):
    """A setting is unknown or out of range; the service does not start."""

    code, title = "config_invalid", "Invalid configuration"
