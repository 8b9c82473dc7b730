"""Arrays on a line: every direction and its image give the same steering vector."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.doa.array import MicrophoneArray
from service.doa.mirror import into_searched_half, searched_half
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, steering_vectors

GRID = azimuth_grid()


def line(azimuth_deg: float, height: float = 0.0) -> MicrophoneArray:
    """Four microphones along an azimuth; with a height, every other one so many metres up."""
    direction = np.array([np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg)), 0.0])
    positions = 0.04 * np.arange(4)[:, None] * direction
    positions[::2, 2] += height
    return MicrophoneArray("line", positions)


@given(along=st.floats(0, 180), azimuth=st.floats(0, 6.28), height=st.sampled_from([0, 0.05]))
def test_the_image_sounds_the_same_and_is_searched(
    along: float, azimuth: float, height: float
) -> None:
    """A line and a panel in a vertical plane have mirror images."""
    array = line(along, height)
    assert array.linear
    image = into_searched_half(array, np.array([azimuth]))
    pair = np.array([azimuth, float(image[0])])
    steering = steering_vectors(array.positions, np.array([500.0, 2000.0]), pair)
    np.testing.assert_allclose(steering[..., 0], steering[..., 1], atol=1e-4)
    assert searched_half(array, image).all() or np.isclose(np.cos(image - azimuth), 1)


@pytest.mark.parametrize(
    ("along", "inside", "outside"), [(90, [0, 60, 300], [180, 120]), (0, [90, 10], [270, 350])]
)
def test_the_front_is_searched(along: float, inside: list[int], outside: list[int]) -> None:
    searched = searched_half(line(along), GRID)
    assert searched[inside].all()
    assert not searched[outside].any()
    assert 180 <= searched.sum() <= 182


def test_other_arrays_are_searched_all_round() -> None:
    square = preset("respeaker-usb-4mic-v2")
    assert searched_half(square, GRID).all()
    np.testing.assert_array_equal(into_searched_half(square, GRID), GRID)
