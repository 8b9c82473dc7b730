"""A rate with a burst: what one connection may send."""

from __future__ import annotations


class Allowance:
    """A token bucket.

    Parameters
    ----------
    per_s : float
        Tokens that come back each second.
    burst : float
        Tokens after a quiet time.
    now : float
        Seconds of the caller's clock.
    """

    def __init__(self, per_s: float, burst: float, now: float) -> None:
        self._per_s = per_s
        self._burst = burst
        self._left = burst
        self._since = now

    def spend(self, tokens: float, now: float) -> None:
        """Take tokens, also ones that are not there yet."""
        self._left = min(self._burst, self._left + (now - self._since) * self._per_s) - tokens
        self._since = now

    def wait_s(self) -> float:
        """Seconds from the last spending until nothing is owed."""
        return max(0.0, -self._left / self._per_s)
