"""Poses: how a robot's head is turned over time, and the turns between two moments.

Conventions
-----------
A rotation is a unit quaternion (w, x, y, z) that takes a vector of the robot's frame to the
world's. Yaw turns about z (counter-clockwise), pitch about y (positive: nose down), roll about x,
in this order after each other as ROS' REP 103 has them: R = Rz(yaw) Ry(pitch) Rx(roll).

References
----------
Shoemake, 1985, Animating rotation with quaternion curves.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from service.doa.kalman import Vector
from service.doa.types import FloatArray

MOST_POSES = 4096
"""Poses that are kept, 20 s at 200 a second"""
EXTRAPOLATION_S = 0.1
"""Seconds for which a turn is taken to go on after the newest pose; it is held afterwards"""
SLOPE_S = 0.1
"""Seconds over which the rate of that turn is measured: single poses are noisy"""


class Rotation(NamedTuple):
    """A unit quaternion."""

    w: float
    x: float
    y: float
    z: float

    @classmethod
    def of_angles(cls, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Rotation:
        """The rotation of three angles in radians."""
        (cy, sy), (cp, sp), (cr, sr) = (
            (math.cos(angle / 2), math.sin(angle / 2)) for angle in (yaw, pitch, roll)
        )
        return cls(
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        )

    @property
    def inverse(self) -> Rotation:
        return Rotation(self.w, -self.x, -self.y, -self.z)

    @property
    def yaw(self) -> float:
        """The turn about z in radians that comes nearest to this rotation."""
        return 2 * math.atan2(self.z, self.w)

    @property
    def angle(self) -> float:
        """Size of the whole turn in radians, at most pi."""
        return 2 * math.atan2(math.hypot(self.x, self.y, self.z), abs(self.w))

    @property
    def angles(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll in radians."""
        w, x, y, z = self
        pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - x * z))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return yaw, pitch, math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))

    @property
    def matrix(self) -> FloatArray:
        """The rotation as a matrix (3, 3)."""
        return np.array([self.turn(axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]).T

    def after(self, first: Rotation) -> Rotation:
        """The rotation that turns by ``first`` and then by this one."""
        (a, b, c, d), (w, x, y, z) = self, first
        return Rotation(
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        )

    def turn(self, vector: Vector) -> Vector:
        """A vector after this rotation."""
        turned = self.after(Rotation(0.0, *vector)).after(self.inverse)
        return turned.x, turned.y, turned.z

    def towards(self, other: Rotation, share: float) -> Rotation:
        """The rotation at this share of the way to another; beyond it where the share exceeds 1."""
        way = other.after(self.inverse)
        sign = math.copysign(1.0, way.w)
        sine = math.hypot(way.x, way.y, way.z)
        if sine < 1e-12:
            return self
        half = math.atan2(sine, abs(way.w)) * share
        scale = sign * math.sin(half) / sine
        part = Rotation(math.cos(half), scale * way.x, scale * way.y, scale * way.z)
        return part.after(self)


class Pose(NamedTuple):
    """A rotation into the world's frame at one moment."""

    time: float
    """Seconds of the stream"""
    rotation: Rotation


STILL = Rotation(1.0, 0.0, 0.0, 0.0)


def mean_rotation(rotations: Iterable[Rotation]) -> Rotation:
    """The mean of rotations that are close to each other."""
    first, *others = rotations
    sums = list(first)
    for other in others:
        sign = math.copysign(1.0, sum(a * b for a, b in zip(first, other, strict=True)))
        sums = [total + sign * value for total, value in zip(sums, other, strict=True)]
    length = math.hypot(*sums)
    return Rotation(*(value / length for value in sums))


class PoseTrack:
    """A head's rotation over the time of a stream, from poses in any order."""

    def __init__(self) -> None:
        self._poses: list[Pose] = []

    def __bool__(self) -> bool:
        return bool(self._poses)

    def add(self, pose: Pose) -> None:
        """Take a pose, of any time."""
        insort(self._poses, pose)
        del self._poses[:-MOST_POSES]

    def at(self, time: float) -> Rotation:
        """The rotation at a time, between the poses around it; the first one holds before it."""
        place = bisect_right(self._poses, Pose(time, _LAST))
        if place == 0:
            return self._poses[0][1]
        if place == len(self._poses):
            return self._ahead(time)
        (begin, before), (end, after) = self._poses[place - 1], self._poses[place]
        return before.towards(after, (time - begin) / (end - begin))

    def around(self, time: float, width: float) -> Rotation:
        """The mean rotation over ``width`` seconds around a time: single poses are noisy."""
        steps = (-0.4, -0.2, 0.0, 0.2, 0.4)
        return mean_rotation(self.at(time + step * width) for step in steps)

    def _ahead(self, time: float) -> Rotation:
        """The newest rotation, turned on for a moment at the rate of the last ones."""
        newest, last = self._poses[-1]
        place = bisect_right(self._poses, Pose(newest - SLOPE_S, _LAST)) - 1
        begin, before = self._poses[max(place, 0)]
        if newest - begin < SLOPE_S / 2 or newest - begin > 4 * SLOPE_S:
            return last
        return before.towards(last, 1 + min(time - newest, EXTRAPOLATION_S) / (newest - begin))


_LAST = Rotation(math.inf, 0.0, 0.0, 0.0)
"""Behind every rotation in the order of tuples"""
