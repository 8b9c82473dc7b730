"""The filter of directions against the textbook, the truth, and itself elsewhere on the sphere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from service.doa.kalman import DirectionFilter, angle, angles, direction
from service.doa.peaks import circular_difference


def filtering(
    azimuth: float,
    turning: float,
    *covariance: float,
    elevation: float = 0.0,
    climbing: float = 0.0,
) -> DirectionFilter:
    """A filter that goes to the left and upwards with these velocities."""
    east, north = (-math.sin(azimuth), math.cos(azimuth)), (math.cos(azimuth), math.sin(azimuth))
    up = [-math.sin(elevation) * part for part in north]
    velocity = (
        turning * east[0] + climbing * up[0],
        turning * east[1] + climbing * up[1],
        climbing * math.cos(elevation),
    )
    return DirectionFilter(direction(azimuth, elevation), velocity, *covariance)


def test_prediction_in_two_halves_is_that_in_one() -> None:
    state = filtering(1.0, 0.3, 0.02, 0.01, 0.09, elevation=0.7, climbing=-0.5)
    whole, halves = replace(state), replace(state)
    whole.predict(0.8, 1.5, 0.35)
    halves.predict(0.3, 1.5, 0.35)
    halves.predict(0.5, 1.5, 0.35)
    for name in DirectionFilter.__slots__:
        assert getattr(halves, name) == pytest.approx(getattr(whole, name), rel=1e-9), name


def test_the_filter_is_the_textbook_s_in_matrices() -> None:
    """Damped motion by the matrix exponential, its noise by Van Loan, the update in matrices."""
    damping, spread, duration, variance = 1.5, 0.35, 0.4, 0.01
    mean, covariance = np.array([1.0, 0.3]), np.array([[0.02, 0.01], [0.01, 0.09]])
    drift = np.array([[0.0, 1.0], [0.0, -1 / damping]])
    noise = np.diag([0.0, 2 * spread**2 / damping])
    joint = np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]])
    exponential = scipy.linalg.expm(joint * duration)
    move = exponential[2:, 2:].T
    mean = move @ mean
    covariance = move @ covariance @ move.T + move @ exponential[:2, 2:]
    gain = covariance[:, 0] / (covariance[0, 0] + variance)
    mean = mean + gain * (1.2 - mean[0])
    covariance = covariance - np.outer(gain, covariance[0])

    state = filtering(1.0, 0.3, 0.02, 0.01, 0.09)
    state.predict(duration, damping, spread)
    state.correct(direction(1.2, None), variance, fastest=10.0)
    assert (angles(state.direction)[0], state.turning) == pytest.approx(tuple(mean))
    assert (state.variance, state.covariance, state.velocity_variance) == pytest.approx(
        (covariance[0, 0], covariance[0, 1], covariance[1, 1])
    )


def test_the_covariance_is_consistent() -> None:
    """NEES of talkers who move as the model says lies within its chi-squared bounds."""
    damping, spread, error, interval = 3.0, math.radians(20), math.radians(3), 0.1
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(200):
        azimuth, velocity = rng.uniform(0, 2 * np.pi), spread * rng.standard_normal()
        first = azimuth + error * rng.standard_normal()
        state = filtering(first, 0.0, error**2, 0.0, spread**2)
        for _ in range(30):
            for _ in range(20):  # the truth moves in steps too short for the filter to know them
                azimuth += velocity * interval / 20
                velocity += (
                    -velocity / damping * interval / 20
                    + spread * math.sqrt(2 * interval / 20 / damping) * rng.standard_normal()
                )
            state.predict(interval, damping, spread)
            measured = direction(azimuth + error * rng.standard_normal(), None)
            state.correct(measured, error**2, fastest=10.0)
        found, _ = angles(state.direction)
        off = np.array([circular_difference(found, azimuth), state.turning - velocity])
        covariance = np.array(
            [
                [state.variance, state.covariance],
                [state.covariance, state.velocity_variance],
            ]
        )
        squares.append(off @ np.linalg.solve(covariance, off))
    low, high = scipy.stats.chi2.ppf([0.001, 0.999], 2 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_the_filter_knows_no_pole() -> None:
    """One who walks past overhead is filtered like one who walks around on the horizon."""
    level, steep = (filtering(0.0, 0.0, 0.003, 0.0, 0.2) for _ in range(2))
    rng = np.random.default_rng(4)
    for step in range(1, 60):
        way, aside = 0.05 * step + rng.normal(0, 0.05), rng.normal(0, 0.05)
        on_horizon = direction(way, aside)
        x, y, z = on_horizon
        overhead = (x, -z, y)  # the same, turned about the x axis by a quarter
        for state, measured in ((level, on_horizon), (steep, overhead)):
            state.predict(0.1, 3.0, 0.4)
            state.correct(measured, 0.003, fastest=2.0)
        x, y, z = level.direction
        assert steep.direction == pytest.approx((x, -z, y), abs=1e-9)
        assert steep.speed == pytest.approx(level.speed, abs=1e-9)
    assert angle(steep.direction, direction(0.0, 0.05 * 59)) < 0.1
