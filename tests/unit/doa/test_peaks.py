"""Peak picking on the circle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.doa.peaks import circular_difference, find_peaks
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray

GRID = azimuth_grid()


def bump(azimuth: float, width: float = 0.1) -> FloatArray:
    difference = (GRID - azimuth + np.pi) % (2 * np.pi) - np.pi
    result: FloatArray = 1 / (1 + (difference / width) ** 2)
    return result


@given(st.floats(0, 2 * np.pi, exclude_max=True))
def test_a_smooth_peak_is_found_between_grid_angles_anywhere(azimuth: float) -> None:
    (peak,) = find_peaks(bump(azimuth), 1)
    assert abs(circular_difference(peak.azimuth, azimuth)) < np.deg2rad(0.01)


@pytest.mark.parametrize("azimuth_deg", [0.0, 359.0, 359.6, 0.4])
def test_peaks_at_the_seam_are_found(azimuth_deg: float) -> None:
    (peak,) = find_peaks(bump(np.deg2rad(azimuth_deg)), 3)
    assert abs(circular_difference(peak.azimuth, np.deg2rad(azimuth_deg))) < np.deg2rad(0.01)
    assert 0 <= peak.azimuth < 2 * np.pi


def test_highest_first_and_no_more_than_asked() -> None:
    spectrum = bump(1.0) + 0.6 * bump(3.0) + 0.8 * bump(5.0)
    assert [round(p.azimuth) for p in find_peaks(spectrum, 3)] == [1, 5, 3]
    assert [round(p.azimuth) for p in find_peaks(spectrum, 2)] == [1, 5]


def test_close_maxima_count_once_also_across_the_seam() -> None:
    spectrum = np.zeros(360)
    spectrum[[358, 2, 90]] = 1.0, 0.9, 0.5
    peaks = find_peaks(spectrum, 3, min_separation=np.deg2rad(10))
    assert [round(np.rad2deg(p.azimuth)) for p in peaks] == [358, 90]


@pytest.mark.parametrize("spectrum", [np.zeros(360), np.ones(360)])
def test_a_constant_spectrum_has_no_peak(spectrum: FloatArray) -> None:
    assert find_peaks(spectrum, 2) == []


def test_a_plateau_of_two_is_one_peak() -> None:
    spectrum = np.zeros(360)
    spectrum[[100, 101]] = 1.0
    (peak,) = find_peaks(spectrum, 4)
    assert np.rad2deg(peak.azimuth) == pytest.approx(100.5, abs=0.51)
