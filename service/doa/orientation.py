"""Azimuths in the array's and the robot's frame, and the excluded sectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.peaks import wrapped
from service.doa.types import FloatArray

WIRE_GRID = 360
"""Number of values of a spectrum as users get it"""


@dataclass(frozen=True, slots=True)
class Orientation:
    """Mounting of the array, and sectors where nothing is reported."""

    yaw: float = 0.0
    """Radians by which the array is turned counter-clockwise on the robot"""
    excluded: Sequence[tuple[float, float]] = ()
    """Sectors (from, to) in radians in the robot's frame, counter-clockwise"""

    @classmethod
    def of_degrees(cls, yaw: float, excluded: Sequence[tuple[float, float]]) -> Orientation:
        """The orientation given by the wire's degrees; the yaw may be any finite angle."""
        sectors = tuple((math.radians(first), math.radians(last)) for first, last in excluded)
        # Exact: radians of many turns would lose the angle's last digits.
        return cls(math.radians(math.remainder(yaw, 360)), sectors)

    def on_robot(self, azimuth: float) -> float:
        """An azimuth of the array's frame in the robot's, in [0, 2 pi)."""
        return wrapped(azimuth + self.yaw)

    def excludes(self, azimuth: float) -> bool:
        """Whether an azimuth of the array's frame lies in an excluded sector."""
        turned = self.on_robot(azimuth)
        return any(
            (turned - first) % (2 * math.pi) <= (last - first) % (2 * math.pi)
            for first, last in self.excluded
        )

    def spectrum_on_robot(self, spectrum: FloatArray) -> FloatArray:
        """A spectrum (A,) of the array's frame at 0, 1, ... 359 degrees of the robot's."""
        if self.yaw == 0 and spectrum.size == WIRE_GRID:
            return spectrum
        places = np.arange(WIRE_GRID) / WIRE_GRID - self.yaw / (2 * math.pi)
        closed = np.append(spectrum, spectrum[0])
        values: FloatArray = np.interp(places % 1 * spectrum.size, np.arange(closed.size), closed)
        return values

    def sphere_on_robot(self, image: FloatArray) -> FloatArray:
        """An image of the sphere (E, A) of the array's frame in the robot's, as ``spectrum``s are.

        Columns are azimuths from 0, evenly spaced; between two of them values are interpolated.
        """
        columns = self.yaw / (2 * math.pi) * image.shape[1]
        whole = math.floor(columns)
        turned: FloatArray = np.roll(image, whole, axis=1)
        share = columns - whole
        return turned + share * (np.roll(turned, 1, axis=1) - turned) if share else turned


def turned(spectra: FloatArray, yaw: float) -> FloatArray:
    """Spectra (..., A) on a circle after a counter-clockwise turn in radians, interpolated."""
    steps = yaw / (2 * math.pi) * spectra.shape[-1]
    whole = math.floor(steps)
    share = spectra.dtype.type(steps - whole)
    before = np.roll(spectra, whole, axis=-1)
    values: FloatArray = before + share * (np.roll(before, 1, axis=-1) - before)
    return values


ALIGNED = Orientation()
"""The array's frame is the robot's, and no sector is excluded"""
