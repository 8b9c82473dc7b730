"""A Kalman filter for one direction on the sphere that moves with a damped velocity.

Conventions
-----------
State: direction as a unit vector, and velocity as a tangent vector there, radians per second.
Errors are the same in every tangent direction, so three numbers are the whole covariance, and a
direction that stays on the horizon is filtered as an azimuth on the circle. The velocity is an
Ornstein-Uhlenbeck process: it forgets itself with a time constant and has a stationary standard
deviation, so that it neither runs away nor depends on how often the filter is called. Plain floats
are several times faster than arrays here.

References
----------
Bar-Shalom, Li, Kirubarajan, 2001, Estimation with Applications to Tracking and Navigation, ch. 5;
Singer, 1970, for the correlated motion, here of the velocity instead of the acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from service.doa.peaks import wrapped

Vector = tuple[float, float, float]
STILL: Vector = (0.0, 0.0, 0.0)


def direction(azimuth: float, elevation: float | None) -> Vector:
    """Unit vector of angles in radians; without an elevation it lies on the horizon."""
    if elevation is None:
        return math.cos(azimuth), math.sin(azimuth), 0.0
    level = math.cos(elevation)
    return level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)


def angles(vector: Vector) -> tuple[float, float]:
    """Azimuth in [0, 2 pi) and elevation of a vector, radians."""
    x, y, z = vector
    return wrapped(math.atan2(y, x)), math.atan2(z, math.hypot(x, y))


def angle(first: Vector, second: Vector) -> float:
    """Great-circle angle between two unit vectors in radians, at most pi."""
    return math.hypot(*_way(first, second))


@dataclass(slots=True)
class DirectionFilter:
    """Mean and covariance of direction and velocity; changed in place."""

    direction: Vector
    """Unit vector"""
    velocity: Vector
    """Tangent vector, radians per second"""
    variance: float
    """Variance of the direction along every tangent, radians squared"""
    covariance: float
    """Covariance of direction and velocity, radians squared per second"""
    velocity_variance: float
    """Radians squared per second squared"""

    @property
    def speed(self) -> float:
        """Magnitude of the velocity in radians per second."""
        return math.hypot(*self.velocity)

    @property
    def turning(self) -> float:
        """Velocity of the azimuth in radians per second, counter-clockwise; 0 at a pole."""
        x, y, _ = self.direction
        level = x * x + y * y
        return (x * self.velocity[1] - y * self.velocity[0]) / level if level > 1e-9 else 0.0

    def predict(self, duration: float, damping: float, spread: float) -> None:
        """Predict over a duration, exactly: two halves give the same as the whole.

        Parameters
        ----------
        duration : float
            Seconds, at least 0.
        damping : float
            Seconds in which the velocity falls to 1/e.
        spread : float
            Stationary standard deviation of the velocity, radians per second.
        """
        kept = math.exp(-duration / damping)
        lost = 1 - kept
        reach = damping * lost  # seconds for which the present velocity still counts
        power = spread * spread
        self._move(_times(reach, self.velocity))
        self.velocity = _times(kept, self.velocity)
        self.variance += reach * (
            2 * self.covariance + reach * self.velocity_variance
        ) + 2 * power * damping * (duration - 2 * reach + damping * (1 - kept * kept) / 2)
        self.covariance = (
            kept * (self.covariance + reach * self.velocity_variance) + power * damping * lost**2
        )
        self.velocity_variance = kept * kept * self.velocity_variance + power * (1 - kept * kept)

    def distance(self, measured: Vector, variance: float) -> float:
        """Squared Mahalanobis distance of a measured direction with this error variance."""
        innovation = angle(self.direction, measured)
        return innovation * innovation / (self.variance + variance)

    def correct(self, measured: Vector, variance: float, fastest: float) -> None:
        """Take in a measured direction with this error variance.

        ``fastest`` bounds the velocity's magnitude, radians per second: one outlier must not throw
        a talker around the circle.
        """
        innovation = _way(self.direction, measured)
        total = self.variance + variance
        gain, velocity_gain = self.variance / total, self.covariance / total
        self.velocity = _sum(self.velocity, _times(velocity_gain, innovation))
        speed = self.speed
        if speed > fastest:
            self.velocity = _times(fastest / speed, self.velocity)
        self._move(_times(gain, innovation))
        self.velocity_variance -= velocity_gain * self.covariance
        self.covariance *= 1 - gain
        self.variance *= 1 - gain

    def ahead(self, duration: float) -> Vector:
        """The direction that its velocity takes it to, after a duration in seconds."""
        return _moved(self.direction, _times(duration, self.velocity))

    def relative_speed(self, other: DirectionFilter) -> float:
        """Magnitude in radians per second of the difference between two velocities."""
        theirs = _carried(other.velocity, other.direction, self.direction)
        return math.dist(self.velocity, theirs)

    def _move(self, tangent: Vector) -> None:
        """Go along a tangent vector, in radians, and take the velocity with it."""
        before, self.direction = self.direction, _moved(self.direction, tangent)
        self.velocity = _carried(self.velocity, before, self.direction)


def _way(first: Vector, second: Vector) -> Vector:
    """The tangent vector at ``first`` in radians that leads to ``second``."""
    (a, b, c), (x, y, z) = first, second
    cosine = a * x + b * y + c * z
    across = (x - cosine * a, y - cosine * b, z - cosine * c)
    sine = math.hypot(*across)
    if sine < 1e-12:
        if cosine > 0:
            return STILL
        # Opposite: every way is as long; this one keeps its height.
        level = math.hypot(a, b)
        return (-b / level * math.pi, a / level * math.pi, 0.0) if level else (math.pi, 0.0, 0.0)
    return _times(math.atan2(sine, cosine) / sine, across)


def _moved(start: Vector, tangent: Vector) -> Vector:
    length = math.hypot(*tangent)
    if length == 0:
        return start
    end = _sum(_times(math.cos(length), start), _times(math.sin(length) / length, tangent))
    return _times(1 / math.hypot(*end), end)


def _carried(tangent: Vector, start: Vector, end: Vector) -> Vector:
    """A tangent vector after its transport along the great circle from ``start`` to ``end``."""
    if start == end:
        return tangent
    (a, b, c), (x, y, z), (u, v, w) = start, end, tangent
    opposite = 1 + a * x + b * y + c * z
    if opposite < 1e-9:
        return tangent
    share = (u * x + v * y + w * z) / opposite
    return u - share * (a + x), v - share * (b + y), w - share * (c + z)


def _sum(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def _times(factor: float, vector: Vector) -> Vector:
    return factor * vector[0], factor * vector[1], factor * vector[2]
