"""Directions in time and windows: the shorter arc, gaps, unknown sources, left-out windows."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.datasets.item import DatasetItem, Directions
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch


def degrees(directions: Directions, *times: float) -> FloatArray:
    return np.rad2deg(directions.at(np.array(times)))


def moving(times: list[float], *azimuths: list[float]) -> Directions:
    """Directions of sources, in degrees, at the same times."""
    return Directions(np.array(times), np.deg2rad(np.array(azimuths).T))


def test_between_annotations_lies_the_shorter_arc() -> None:
    over_zero = moving([0.0, 0.4], [350.0, 10.0])
    np.testing.assert_allclose(degrees(over_zero, 0.1, 0.3)[:, 0], [355.0, 5.0], atol=1e-9)
    over_pi = moving([0.0, 0.4], [-170.0, 170.0])
    np.testing.assert_allclose(degrees(over_pi, 0.3)[0], [175.0], atol=1e-9)


def test_an_annotation_is_its_own_value_beside_one_that_is_unknown() -> None:
    directions = moving([0.0, 0.1, 0.2, 0.3], [10.0, np.nan, 30.0, 40.0])
    found = degrees(directions, 0.0, 0.05, 0.1, 0.15, 0.2, 0.25)[:, 0]
    np.testing.assert_allclose(found, [10, np.nan, np.nan, np.nan, 30, 35], atol=1e-9)


def test_nothing_is_known_outside_or_in_a_gap_of_more_than_half_a_second() -> None:
    directions = moving([1.0, 1.4, 2.0], [10.0, 20.0, 30.0])
    found = degrees(directions, 0.9, 1.0, 1.2, 1.4, 1.7, 2.0, 2.1)[:, 0]
    np.testing.assert_allclose(found, [np.nan, 10, 15, 20, np.nan, 30, np.nan], atol=1e-9)


def test_equal_times_of_a_tracker_do_no_harm() -> None:
    directions = moving([0.0, 0.1, 0.1, 0.2], [0.0, 10.0, 10.0, 20.0])
    np.testing.assert_allclose(degrees(directions, 0.05, 0.1, 0.15)[:, 0], [5, 10, 15], atol=1e-9)


def test_one_direction_holds_for_ever() -> None:
    constant = Directions.constant(np.deg2rad([-90.0, 30.0]))
    np.testing.assert_allclose(degrees(constant, -1.0, 100.0), [[270, 30]] * 2, atol=1e-9)


def test_windows_have_the_directions_of_their_middle(square: MicrophoneArray) -> None:
    audio = np.arange(4 * 16000, dtype=np.float32).reshape(4, 16000)
    directions = moving([0.25, 0.5, 0.75], [40.0, 60.0, 80.0], [200.0, np.nan, np.nan])
    item = DatasetItem(audio, square, directions, {})
    windows = list(item.windows(3200, 1600))
    # Middles are 0.1, 0.2 and so on to 0.9 s; the annotations begin at 0.25 s and end at 0.75 s.
    assert [int(window[0, 0]) for window, _ in windows] == [3200, 4800, 6400, 8000, 9600]
    expected = [44.0, 52.0, 60.0, 68.0, 76.0]
    np.testing.assert_allclose([np.rad2deg(a[0]) for _, a in windows], expected, atol=1e-6)
    assert [len(azimuth) for _, azimuth in windows] == [1] * 5
    assert all(window.shape == (4, 3200) for window, _ in windows)


def test_two_sources_where_both_are_known(square: MicrophoneArray) -> None:
    directions = moving([0.0, 0.3, 0.6], [10.0, 10.0, 10.0], [90.0, 90.0, np.nan])
    item = DatasetItem(np.zeros((4, 9600), np.float32), square, directions, {})
    found = [np.rad2deg(azimuth).round(6).tolist() for _, azimuth in item.windows(3200, 3200)]
    assert found == [[10.0, 90.0], [10.0, 90.0], [10.0]]


@pytest.mark.parametrize("samples", [0, 3199])
def test_a_recording_shorter_than_a_window_has_none(square: MicrophoneArray, samples: int) -> None:
    audio = np.zeros((4, samples), np.float32)
    item = DatasetItem(audio, square, Directions.constant(0.0), {})
    assert list(item.windows(3200, 1600)) == []


def test_impossible_items_are_refused(square: MicrophoneArray) -> None:
    with pytest.raises(ValueError, match="4 microphones"):
        DatasetItem(np.zeros((3, 10), np.float32), square, Directions.constant(0.0), {})
    with pytest.raises(ValueError, match=r"\(K, M\) azimuths"):
        Directions(np.zeros(2), np.zeros((3, 1)))
    with pytest.raises(ValueError, match="at least one time"):
        Directions(np.zeros(0), np.zeros((0, 1)))
