"""The directions in which an array's sources are searched: azimuths, the sphere or a half of it.

An array hears a direction and its mirror image behind a line or a plane of its microphones alike.
A level array therefore tells elevations only where the user says on which side of it sources are.
"""

from __future__ import annotations

import numpy as np

from neuralmusic.protocol.methods import Hemisphere
from service.doa.array import MIRROR_SPREAD, MicrophoneArray
from service.doa.sphere import DirectionGrid, half_sphere, whole_sphere
from service.doa.types import FloatArray

THICKNESS = 0.3
"""Least share of an array's second extent that its third must have, besides ``MIRROR_SPREAD``:
talkers stand near a level plane, where images differ little, and flatter arrays tell them apart
only at the highest frequencies"""
LEVEL = float(np.sqrt(0.5))
"""Least vertical part of the unit normal of a plane whose sides are above and below"""
UPRIGHT = 0.1
"""Largest vertical part of the unit normal of an upright plane, whose sides are front and back"""
SIDES = {"upper": 1.0, "lower": -1.0}


def searched_directions(
    array: MicrophoneArray, hemisphere: Hemisphere = "both"
) -> DirectionGrid | None:
    """The grid of an array's directions; None where it tells azimuths only."""
    dimensions, normal = _shape(array)
    if dimensions == 1:
        return None
    side = SIDES.get(hemisphere)
    if dimensions == 3:
        return whole_sphere() if side is None else half_sphere(np.array([0.0, 0.0, side]))
    if side is not None and abs(normal[2]) > UPRIGHT:
        return half_sphere(normal * (side if normal[2] >= 0 else -side))
    if abs(normal[2]) > LEVEL:
        return None  # its images are above and below
    return half_sphere(facing(normal))


def why_one_side(array: MicrophoneArray, *, elevations: bool) -> str | None:
    """The reason why only one side of an array is reported; None where all round is.

    Parameters
    ----------
    array : MicrophoneArray
    elevations : bool
        Whether the method searches elevations where the array tells them.
    """
    dimensions, normal = _shape(array)
    if dimensions == 1 and array.linear:
        return (
            "all microphones lie on one line: every direction has a mirror image behind the line, "
            "which is left out, and a source above or below the microphones is reported at the "
            "azimuth of its cone about the line, nearer to broadside than it is"
        )
    if array.linear:
        return (
            "all microphones lie on one line, seen from above: every direction has a mirror image "
            "behind the line, which is left out"
        )
    if elevations and dimensions == 2 and abs(normal[2]) <= LEVEL:
        return (
            "all microphones lie in one steep plane: every direction has a mirror image behind "
            "the plane, which is left out"
        )
    return None


def why_no_elevation(array: MicrophoneArray, hemisphere: Hemisphere = "both") -> str | None:
    """The reason why an array tells azimuths only; None where it tells elevations."""
    if searched_directions(array, hemisphere) is not None:
        return None
    if _shape(array)[0] == 1:
        return (
            "the microphones lie nearly on one line, which hears little but the angle to it: the "
            "azimuth is that of a source at the array's height"
        )
    return (
        "the microphones lie in a level plane, which hears a source above it and its mirror image "
        "below it alike: say hemisphere=upper or lower where all sources are on one side"
    )


def facing(normal: FloatArray) -> FloatArray:
    """The normal (3,) of an upright plane that points to +x, or to +y of a plane along x."""
    x, y = normal[:2]
    forward = x if abs(x) > 1e-9 else y
    return normal if forward > 0 else -normal


def _shape(array: MicrophoneArray) -> tuple[int, FloatArray]:
    """Dimensions in which an array tells mirror images apart, 1 to 3, and its plane's normal (3,).

    Each takes ``MIRROR_SPREAD``, and ``THICKNESS`` of the extent before.
    """
    centred = array.positions - array.positions.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2]
    along = centred @ axes.T
    extents, spread = np.ptp(along, axis=0), along.std(axis=0)
    dimensions = 1
    while (
        dimensions < 3
        and spread[dimensions] >= MIRROR_SPREAD
        and extents[dimensions] >= THICKNESS * extents[dimensions - 1]
    ):
        dimensions += 1
    normal: FloatArray = axes[2]
    return dimensions, normal
