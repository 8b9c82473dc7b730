"""A Kalman filter for one azimuth on the circle that moves with a damped velocity.

Conventions
-----------
State: azimuth in radians and velocity in radians per second. The velocity is an Ornstein-Uhlenbeck
process: it forgets itself with a time constant and has a stationary standard deviation, so that it
neither runs away nor depends on how often the filter is called. Two states and one measurement:
plain floats are several times faster than arrays here.

References
----------
Bar-Shalom, Li, Kirubarajan, 2001, Estimation with Applications to Tracking and Navigation, ch. 5;
Singer, 1970, for the correlated motion, here of the velocity instead of the acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from service.doa.peaks import circular_difference, wrapped


@dataclass(slots=True)
class AzimuthFilter:
    """Mean and covariance of azimuth and velocity; changed in place."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    velocity: float
    """Radians per second"""
    azimuth_variance: float
    """Radians squared"""
    covariance: float
    """Covariance of azimuth and velocity, radians squared per second"""
    velocity_variance: float
    """Radians squared per second squared"""

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
        self.azimuth = wrapped(self.azimuth + reach * self.velocity)
        self.velocity *= kept
        self.azimuth_variance += reach * (
            2 * self.covariance + reach * self.velocity_variance
        ) + 2 * power * damping * (duration - 2 * reach + damping * (1 - kept * kept) / 2)
        self.covariance = (
            kept * (self.covariance + reach * self.velocity_variance) + power * damping * lost**2
        )
        self.velocity_variance = kept * kept * self.velocity_variance + power * (1 - kept * kept)

    def distance(self, azimuth: float, variance: float) -> float:
        """Squared Mahalanobis distance of a measured azimuth with this error variance."""
        innovation = circular_difference(azimuth, self.azimuth)
        return innovation * innovation / (self.azimuth_variance + variance)

    def correct(self, azimuth: float, variance: float, fastest: float) -> None:
        """Take in a measured azimuth with this error variance.

        ``fastest`` bounds the velocity's magnitude, radians per second: one outlier must not throw
        a talker around the circle.
        """
        innovation = circular_difference(azimuth, self.azimuth)
        total = self.azimuth_variance + variance
        azimuth_gain, velocity_gain = self.azimuth_variance / total, self.covariance / total
        self.azimuth = wrapped(self.azimuth + azimuth_gain * innovation)
        moved = self.velocity + velocity_gain * innovation
        self.velocity = min(max(moved, -fastest), fastest)
        self.velocity_variance -= velocity_gain * self.covariance
        self.covariance *= 1 - azimuth_gain
        self.azimuth_variance *= 1 - azimuth_gain
