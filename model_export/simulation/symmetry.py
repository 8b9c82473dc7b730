"""Turns and mirrorings that bring an array onto itself: other scenes of what it has heard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray, IntArray

NEAR = 1e-4
"""Metres by which a microphone of a turned array may miss another's place"""


@dataclass(frozen=True, slots=True)
class Symmetry:
    """One way to see a scene: its channels in another order, its azimuths elsewhere."""

    permutation: IntArray
    """(N,) channel that takes the place of each channel"""
    sign: int
    """-1 mirrors at the x axis before the turn"""
    turn: float
    """Radians, counter-clockwise"""

    def azimuth(self, azimuth: FloatArray) -> FloatArray:
        """Azimuths of the sources in the turned or mirrored scene."""
        return self.sign * azimuth + self.turn


def symmetries(array: MicrophoneArray) -> list[Symmetry]:
    """All symmetries about z and upright planes through the array's centre, the identity first.

    Audio whose channels are taken in the order ``permutation`` is what the array hears of the
    turned or mirrored scene: exact data for nothing. A ring of N microphones has 2 N, an irregular
    array only the identity.
    """
    plane = array.positions - array.positions.mean(axis=0)
    angles = np.arctan2(plane[:, 1], plane[:, 0])
    found: list[Symmetry] = []
    for sign in (1, -1):
        mirrored = MicrophoneArray(array.name, plane * np.array([1, sign, 1]))
        for turn in np.unique(np.round((angles - sign * angles[0]) % (2 * np.pi), 6)).tolist():
            turned = mirrored.rotated(turn).positions
            gaps = np.linalg.norm(plane[:, None] - turned[None], axis=-1)
            permutation = gaps.argmin(axis=1)
            if gaps.min(axis=1).max() < NEAR and len(set(permutation.tolist())) == len(plane):
                found.append(Symmetry(permutation, sign, turn))
    return found
