"""What the service answered, whichever library asked it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from neuralmusic.client_errors import ServiceProblem
from neuralmusic.errors import InvalidOption

Answer = dict[str, Any]


@dataclass(frozen=True)
class Answered:
    """One HTTP answer."""

    url: str
    """The address that was asked"""
    status: int
    reason: str
    """The words beside the status"""
    body: bytes
    retry_after: str | None
    """The header ``Retry-After``"""

    def document(self, key: str) -> Answer:
        """The JSON object of the answer, which has this key.

        Raises
        ------
        ServiceProblem
            If the service refused.
        InvalidOption
            If it is another server that answers.
        """
        if not 200 <= self.status < 300:
            raise ServiceProblem.answered(self.status, self.reason, self.body, self.retry_after)
        try:
            document = json.loads(self.body)
        except ValueError:
            document = None
        if not (isinstance(document, dict) and key in document):
            raise InvalidOption(
                f"{self.url} answers, but not as this service does: check the address"
            )
        return document

    def listed(self, name: str) -> list[Answer]:
        """The list of an answer that holds it under its name; raises as ``document``."""
        found: list[Answer] = self.document(name)[name]
        return found
