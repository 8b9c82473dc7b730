"""The directions in which an array's sources are searched: azimuths, the sphere or a half of it.

An array hears a direction and its mirror image behind a line or a plane of its microphones alike.
A level array therefore tells elevations only where the user says on which side of it sources are.
"""

from __future__ import annotations

import numpy as np

from neuralmusic.protocol.methods import Hemisphere
from service.doa.array import MicrophoneArray
from service.doa.sphere import DirectionGrid, half_sphere, whole_sphere
from service.doa.types import FloatArray

THICKNESS = 0.3
"""Least share of an array's second extent that its third must have: flatter arrays tell a direction
from its mirror image in their plane only at the highest frequencies"""
LEAST_HEIGHT = 0.005
"""Metres, the least such extent"""
SIDES = {"upper": 1.0, "lower": -1.0}


def searched_directions(
    array: MicrophoneArray, hemisphere: Hemisphere = "both"
) -> DirectionGrid | None:
    """The grid of an array's directions; None where it tells azimuths only."""
    extents, axes = _extents(array)
    if _is_line(extents):
        return None
    side = SIDES.get(hemisphere)
    if extents[2] >= max(LEAST_HEIGHT, THICKNESS * extents[1]):
        return whole_sphere() if side is None else half_sphere(np.array([0.0, 0.0, side]))
    normal = axes[2]
    if side is not None:
        return half_sphere(normal * (side if normal[2] >= 0 else -side))
    if abs(normal[2]) > np.sqrt(0.5):
        return None  # level: its images are above and below
    return half_sphere(facing(normal))


def why_no_elevation(array: MicrophoneArray, hemisphere: Hemisphere = "both") -> str | None:
    """The reason why an array tells azimuths only; None where it tells elevations."""
    if searched_directions(array, hemisphere) is not None:
        return None
    if _is_line(_extents(array)[0]):
        return (
            "the microphones lie on one line, which hears only the angle to its axis: the azimuth "
            "is that of a source at the array's height"
        )
    return (
        "the microphones lie in a level plane, which hears a source above it and its mirror image "
        "below it alike: say hemisphere=upper or lower where all sources are on one side"
    )


def _is_line(extents: FloatArray) -> bool:
    return bool(extents[1] < max(LEAST_HEIGHT, THICKNESS * extents[0]))


def facing(normal: FloatArray) -> FloatArray:
    """The normal (3,) of an upright plane that points to +x, or to +y of a plane along x."""
    x, y = normal[:2]
    forward = x if abs(x) > 1e-9 else y
    return normal if forward > 0 else -normal


def _extents(array: MicrophoneArray) -> tuple[FloatArray, FloatArray]:
    """Extents (3,) in metres along the axes (3, 3) of an array, the largest first."""
    centred = array.positions - array.positions.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2]
    extents: FloatArray = np.ptp(centred @ axes.T, axis=0)
    return extents, axes
