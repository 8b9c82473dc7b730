"""The phases of a graceful shutdown; whatever refuses work because of it asks here."""

from __future__ import annotations

from enum import IntEnum

from neuralmusic.errors import Draining


class Phase(IntEnum):
    """The phases of a process, in their order."""

    READY = 0
    LEAVING = 1
    """Report not ready, keep accepting: load balancers should send new work elsewhere"""
    DRAINING = 2
    """Accept nothing new, finish running work"""
    ENDING = 3
    """Stop what still runs"""


class Lifecycle:
    """The phase of one service; it only moves forward."""

    def __init__(self) -> None:
        self._phase = Phase.READY

    def enter(self, phase: Phase) -> None:
        """Move to a phase; an earlier one than the present changes nothing."""
        self._phase = max(self._phase, phase)

    def reached(self, phase: Phase) -> bool:
        """Whether the service is in this phase or a later one."""
        return self._phase >= phase

    def check(self, phase: Phase) -> None:
        """Raise Draining from this phase on."""
        if self.reached(phase):
            raise Draining("the service is shutting down: try again in a moment")
