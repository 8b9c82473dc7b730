"""What every answer has to be, and the count of what they were."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import neuralmusic.client_errors  # noqa: F401  (part of the tree)
from neuralmusic.errors import DoaError
from service.recordings.answers import LocalizationAnswer

from .http import Answer

PROMPT_S = 2.0
"""Seconds within which everything must be answered"""
SHOWN = 10
"""Most failures that a test reports"""


def problems(error: type[DoaError] = DoaError) -> dict[str, int]:
    """Statuses by the codes of the error tree."""
    found = {error.code: error.status}
    for child in error.__subclasses__():
        found |= problems(child)
    return found


CODES = problems()
OVERLOAD = {"overloaded"}


def complaint(answer: Answer) -> str | None:
    """What is wrong with an answer to ``POST /localize``; None where it is as documented."""
    if answer.status == 200:
        return _broken_result(answer)
    if answer.headers.get("content-type") != "application/problem+json":
        return f"{answer.status} is {answer.headers.get('content-type')}, no problem"
    try:
        problem = json.loads(answer.content)
    except ValueError as error:
        return f"{answer.status} is no JSON: {error}"
    if set(problem) != {"type", "title", "status", "detail", "code"}:
        return f"{answer.status} is no problem: {sorted(problem)}"
    code = problem["code"]
    if CODES.get(code) != answer.status or problem["status"] != answer.status:
        return f"{answer.status} with code {code}"
    if answer.status >= 500 and (code not in OVERLOAD or "retry-after" not in answer.headers):
        return f"{answer.status} {code}: {problem['detail']}"
    return None


def _broken_result(answer: Answer) -> str | None:
    if answer.headers.get("content-type") != "application/json":
        return f"200 is {answer.headers.get('content-type')}"
    try:
        LocalizationAnswer.model_validate_json(answer.content, strict=True)
        json.loads(answer.content, parse_constant=_refuse)
    except ValueError as error:
        return f"200 is no answer: {str(error)[:300]}"
    return None


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no JSON")


@dataclass
class Tally:
    """All answers of one run."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: list[tuple[float, str]] = field(default_factory=list)
    repeated: int = 0
    """Slow answers that were prompt when repeated alone"""
    failures: list[str] = field(default_factory=list)

    def count(self, outcome: str, seconds: float, what: str) -> None:
        """Take in one answer."""
        self.outcomes[outcome] += 1
        self.slowest = sorted([*self.slowest, (seconds, what)], reverse=True)[:3]

    def fail(self, what: str, evidence: bytes, path: Path) -> None:
        """Keep what failed, and the bytes that made it fail."""
        path.write_bytes(evidence)
        self.failures.append(f"{what} ({path})")

    def __str__(self) -> str:
        by_count = ", ".join(f"{name}: {count}" for name, count in self.outcomes.most_common())
        slowest = "; ".join(f"{seconds:.2f} s {what}" for seconds, what in self.slowest)
        return (
            f"{self.outcomes.total()} in all: {by_count}\nslowest: {slowest}\n"
            f"slow, but prompt when repeated alone: {self.repeated}"
        )

    def check(self) -> None:
        """Fail with what failed."""
        told = "\n".join(self.failures[:SHOWN])
        assert not self.failures, f"{len(self.failures)} failed, among them\n{told}"
