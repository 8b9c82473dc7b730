"""How far an array tells directions apart, against the definition on a grid."""

from __future__ import annotations

import numpy as np
import pytest

from service.doa.presets import preset
from service.doa.steering import azimuth_grid, resolution, steering_vectors

FREQUENCIES = np.arange(1, 257) * 31.25


@pytest.mark.parametrize("name", ["respeaker-usb-4mic-v2", "respeaker-6mic-circular"])
def test_resolution_is_the_mean_distance_of_all_pairs_of_steering_vectors(name: str) -> None:
    positions = preset(name).positions
    steering = steering_vectors(positions, FREQUENCIES, azimuth_grid(72))
    products = np.conj(np.swapaxes(steering, 1, 2)) @ steering / len(positions)
    expected = 1 - np.square(np.abs(products)).mean()
    assert resolution(positions, FREQUENCIES) == pytest.approx(expected, abs=1e-4)


def test_resolution_grows_with_the_array_and_height_adds_nothing() -> None:
    ring = preset("respeaker-usb-4mic-v2").positions
    values = [resolution(scale * ring, FREQUENCIES) for scale in (0.01, 0.1, 0.5, 1, 3)]
    assert values == sorted(values)
    assert values[0] < 1e-3
    assert values[-1] <= 1 - 1 / len(ring)
    column = np.array([[0, 0, 0], [0, 0, 0.05], [0, 0, 0.1]])
    assert resolution(column, FREQUENCIES) == pytest.approx(0)
