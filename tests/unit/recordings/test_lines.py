"""What a recording's answer says of arrays with mirror images."""

from __future__ import annotations

import numpy as np
import pytest

from service import localize
from service.doa.array import MicrophoneArray

LINE = [[0.0, 0.0, 0.0], [0.001, 0.03, 0.0], [0.0, 0.06, 0.0], [0.001, 0.09, 0.0]]
"""Whole millimetres along a line at 89.6 degrees"""


@pytest.mark.parametrize("method", ["neural", "norm_music"])
@pytest.mark.parametrize("elevation_deg", [0.0, 40.0])
def test_a_line_says_that_its_azimuths_are_those_of_cones(
    method: str, elevation_deg: float, plane_waves
) -> None:
    array = MicrophoneArray("line", np.array(LINE))
    sound = plane_waves(array, [140.0], elevation_deg=elevation_deg).T
    answer = localize(sound, 16_000, array=LINE, method=method)
    (warning,) = [each for each in answer.warnings if each.code == "front_back_ambiguous"]
    assert "cone about the line" in warning.detail
    # sin of the angle from broadside is cos(elevation) times that of the azimuth before the line.
    cone = np.arcsin(np.cos(np.deg2rad(elevation_deg)) * np.sin(np.deg2rad(40.0)))
    azimuth = answer.summary.sources[0].azimuth_deg
    assert azimuth == pytest.approx(np.rad2deg(cone), abs=4)
