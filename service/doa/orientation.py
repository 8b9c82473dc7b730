"""Azimuths between the array's frame and the robot's, and the sectors that are left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.peaks import wrapped
from service.doa.types import FloatArray

WIRE_GRID = 360
"""Values of a spectrum as users get it"""


@dataclass(frozen=True, slots=True)
class Orientation:
    """How the array is mounted, and where nothing is reported."""

    yaw: float = 0.0
    """Radians that the array is turned counter-clockwise on the robot"""
    excluded: Sequence[tuple[float, float]] = ()
    """Sectors from, to in radians in the robot's frame, counter-clockwise"""

    @classmethod
    def of_degrees(cls, yaw: float, excluded: Sequence[tuple[float, float]]) -> Orientation:
        """From the wire's degrees."""
        sectors = tuple((math.radians(first), math.radians(last)) for first, last in excluded)
        return cls(math.radians(yaw), sectors)

    def on_robot(self, azimuth: float) -> float:
        """The robot's azimuth in [0, 2 pi) of the array's."""
        return wrapped(azimuth + self.yaw)

    def excludes(self, azimuth: float) -> bool:
        """True where the array's azimuth lies in an excluded sector."""
        turned = self.on_robot(azimuth)
        return any(
            (turned - first) % (2 * math.pi) <= (last - first) % (2 * math.pi)
            for first, last in self.excluded
        )

    def spectrum_on_robot(self, spectrum: FloatArray) -> FloatArray:
        """A spectrum (A,) of the array's azimuths at 0, 1, ... 359 degrees of the robot's."""
        if self.yaw == 0 and spectrum.size == WIRE_GRID:
            return spectrum
        turned = np.arange(WIRE_GRID) / WIRE_GRID - self.yaw / (2 * math.pi)
        closed = np.append(spectrum, spectrum[0])
        values: FloatArray = np.interp(turned % 1 * spectrum.size, np.arange(closed.size), closed)
        return values


ALIGNED = Orientation()
"""The array's x is the robot's, and nothing is left out"""
