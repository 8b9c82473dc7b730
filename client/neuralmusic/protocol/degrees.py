"""Angles in degrees as they are sent; all computation is in radians."""

from __future__ import annotations

import math
from typing import Optional


def degrees(radians: float) -> float:
    """Degrees, to a hundredth."""
    return round(math.degrees(radians), 2)


def azimuth_deg(azimuth: float) -> float:
    """Degrees in [0, 360) of an angle in radians; 359.999 rounds to 0, not to 360."""
    return degrees(azimuth) % 360.0


def elevation_deg(elevation: Optional[float]) -> Optional[float]:
    """Degrees of an angle in radians, if there is one."""
    return None if elevation is None else degrees(elevation)


def unit_vector(azimuth: float, elevation: Optional[float] = None) -> list[float]:
    """``[x, y, z]`` towards angles in radians; without an elevation in the horizontal plane."""
    level, height = (1.0, 0.0) if elevation is None else (math.cos(elevation), math.sin(elevation))
    x, y = level * math.cos(azimuth), level * math.sin(azimuth)
    return [round(x, 5), round(y, 5), round(height, 5)]
