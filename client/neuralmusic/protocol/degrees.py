"""Angles in degrees as they are sent; all computation is in radians."""

from __future__ import annotations

import math


def degrees(radians: float) -> float:
    """Degrees, to a hundredth."""
    return round(math.degrees(radians), 2)


def azimuth_deg(azimuth: float) -> float:
    """Degrees in [0, 360) of an angle in radians; 359.999 rounds to 0, not to 360."""
    return degrees(azimuth) % 360.0


def unit_vector(azimuth: float) -> list[float]:
    """``[x, y, z]`` towards an azimuth in radians, in the horizontal plane."""
    return [round(math.cos(azimuth), 5), round(math.sin(azimuth), 5), 0.0]
