"""The mirror images that arrays on one line cannot tell from the source.

A line hears only the angle to its axis: a source in front of it and its mirror image behind it give
the same signals. The same holds for any array that is a line seen from above, such as one in a
vertical plane, and horizontal directions. Only one half of the circle is searched then: the one
towards +x, or towards +y for a line along x.
"""

from __future__ import annotations

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.types import BoolArray, FloatArray


def searched_half(array: MicrophoneArray, azimuth: FloatArray) -> BoolArray:
    """(A,) True for the azimuths to search: all, or those on the searched side of a line."""
    if not array.linear:
        return np.ones(azimuth.shape, dtype=bool)
    side = azimuth - _normal(array)
    # The line's own directions are their own images and belong to the half.
    return np.asarray(np.cos(side) >= -1e-9)


def into_searched_half(array: MicrophoneArray, azimuth: FloatArray) -> FloatArray:
    """Azimuths in [0, 2 pi) with those behind a line replaced by their images before it."""
    if not array.linear:
        return azimuth
    image = np.pi + 2 * _normal(array) - azimuth
    folded: FloatArray = np.where(searched_half(array, azimuth), azimuth, image) % (2 * np.pi)
    return folded


def _normal(array: MicrophoneArray) -> float:
    """Azimuth of the direction square to the line on the searched side, radians."""
    x, y = array.axis
    normal = np.array([-y, x])
    if normal[0] < -1e-9 or (abs(normal[0]) <= 1e-9 and normal[1] < 0):
        normal = -normal
    return float(np.arctan2(normal[1], normal[0]))
