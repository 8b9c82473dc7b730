"""An answer of the service, independent of the HTTP library."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from neuralmusic.client_errors import InvalidAnswer, ServiceProblem

Answer = dict[str, Any]


@dataclass(frozen=True)
class Answered:
    """One HTTP answer."""

    url: str
    """Address of the request"""
    status: int
    reason: str
    """Reason phrase of the status"""
    body: bytes
    retry_after: str | None
    """Header ``Retry-After``"""

    def document(self, key: str) -> Answer:
        """The JSON object of the answer, which must have a list under this key.

        Raises
        ------
        ServiceProblem
            If the service refused.
        InvalidAnswer
            If something else answers.
        """
        if not 200 <= self.status < 300:
            raise ServiceProblem.answered(self.status, self.reason, self.body, self.retry_after)
        try:
            document = json.loads(self.body, parse_constant=_no_number)
        except (ValueError, RecursionError):
            document = None
        if not (isinstance(document, dict) and isinstance(document.get(key), list)):
            raise InvalidAnswer(
                f"{self.url} answers, but not as this service does: check the address"
            )
        return document

    def listed(self, name: str) -> list[Answer]:
        """The list under a name in the answer; raises as ``document``."""
        found: list[Answer] = self.document(name)[name]
        return found


def _no_number(constant: str) -> None:
    """JSON has no NaN and no infinity, though Python reads them."""
    raise ValueError(f"{constant} is no JSON")
