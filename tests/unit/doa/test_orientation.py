"""Azimuths between the array's frame and the robot's, and excluded sectors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.doa.orientation import ALIGNED, Orientation
from service.doa.types import FloatArray

angles = st.floats(-720, 720)


@given(yaw=st.floats(-360, 360), azimuth=angles)
def test_the_yaw_is_added_on_the_circle(yaw: float, azimuth: float) -> None:
    turned = Orientation.of_degrees(yaw, ()).on_robot(np.deg2rad(azimuth))
    assert 0 <= turned <= 2 * np.pi
    assert np.exp(1j * turned) == pytest.approx(np.exp(1j * np.deg2rad(azimuth + yaw)))


@given(first=st.floats(-360, 360), width=st.floats(1, 359), inside=st.floats(0, 1))
def test_a_sector_is_counter_clockwise_and_may_cross_zero(
    first: float, width: float, inside: float
) -> None:
    orientation = Orientation.of_degrees(0.0, [(first, first + width)])
    assert orientation.excludes(np.deg2rad(first + 1e-3 + inside * (width - 2e-3)))
    beyond = first + width + 1e-3 + inside * (360 - width - 2e-3)
    assert not orientation.excludes(np.deg2rad(beyond))


def test_sectors_are_in_the_robots_frame() -> None:
    orientation = Orientation.of_degrees(90.0, [(80, 100)])
    assert orientation.excludes(0.0)
    assert not orientation.excludes(np.deg2rad(90))


@pytest.mark.parametrize("size", [180, 360, 720])
@pytest.mark.parametrize("yaw", [0.0, 33.0, -100.5])
def test_a_spectrum_turns_with_its_peak_and_has_360_values(size: int, yaw: float) -> None:
    grid = np.arange(size) * 2 * np.pi / size
    spectrum = np.exp(3 * np.cos(grid - np.deg2rad(70)))
    turned = Orientation.of_degrees(yaw, ()).spectrum_on_robot(spectrum)
    expected = np.exp(3 * np.cos(np.deg2rad(np.arange(360) - 70 - yaw)))
    assert turned.shape == (360,)
    assert np.abs(turned - expected).max() < 0.01 * expected.max()


@pytest.mark.parametrize("yaw", [0.0, 30.0, -17.0, 362.5])
def test_an_image_of_the_sphere_turns_as_its_azimuths_do(yaw: float) -> None:
    def seen(turned: float) -> FloatArray:
        azimuth = np.deg2rad(np.arange(0, 360, 5) - 70 - turned)
        return np.arange(1, 37)[:, None] * np.exp(np.cos(azimuth))

    turned = Orientation.of_degrees(yaw, ()).sphere_on_robot(seen(0.0))
    np.testing.assert_allclose(turned, seen(yaw), rtol=0.003)


def test_aligned_changes_nothing() -> None:
    spectrum = np.random.default_rng(0).random(360)
    assert ALIGNED.spectrum_on_robot(spectrum) is spectrum
    assert not ALIGNED.excludes(1.0)
