"""How far the service is on its way out; everything that refuses work because of it asks here."""

from __future__ import annotations

from enum import IntEnum

from neuralmusic.errors import Draining


class Phase(IntEnum):
    """The phases of a process, in their order."""

    READY = 0
    LEAVING = 1
    """Report not ready, keep accepting: whoever balances loads should send nothing new"""
    DRAINING = 2
    """Accept nothing new; what runs is finished"""
    ENDING = 3
    """What still runs is ended"""


class Lifecycle:
    """The phase of one service; it never goes back."""

    def __init__(self) -> None:
        self._phase = Phase.READY

    def enter(self, phase: Phase) -> None:
        """Go on to a phase; an earlier one than the present changes nothing."""
        self._phase = max(self._phase, phase)

    def reached(self, phase: Phase) -> bool:
        """Whether the service is in this phase or a later one."""
        return self._phase >= phase

    def check(self, phase: Phase) -> None:
        """Raise Draining from this phase on."""
        if self.reached(phase):
            raise Draining("the service is shutting down: try again in a moment")
