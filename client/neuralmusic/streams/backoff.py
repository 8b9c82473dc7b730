"""Delays before the next attempt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import random

MAX_EXPONENT = 60
LONGEST_REQUEST_S = 300.0
"""Longest ``Retry-After`` in seconds; a longer one counts as this"""


@dataclass(frozen=True)
class Backoff:
    """Exponential backoff with full jitter, so that many robots do not return at once.

    The delay is uniform in [0, min(longest, first * factor^attempt)], the best of the schemes in
    M. Brooker, *Exponential Backoff And Jitter*, AWS Architecture Blog, 2015.
    """

    first_s: float = 0.5
    """Upper bound of the first delay in seconds"""
    longest_s: float = 30.0
    """Upper bound of every delay in seconds"""
    factor: float = 2.0

    def delay_s(
        self,
        attempt: int,
        retry_after_s: float | None = None,
        uniform: Callable[[], float] = random,
    ) -> float:
        """Seconds before an attempt.

        Parameters
        ----------
        attempt : int
            Failed attempts since the last success, from 0.
        retry_after_s : float, optional
            Seconds that the service asked for; jitter is added.
        uniform : callable
            Gives numbers in [0, 1).
        """
        bound = min(self.longest_s, self.first_s * self.factor ** min(attempt, MAX_EXPONENT))
        return min(max(retry_after_s or 0.0, 0.0), LONGEST_REQUEST_S) + uniform() * bound
