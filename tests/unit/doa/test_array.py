"""Arrays are validated so that the classic mistakes are named instead of computed with."""

from __future__ import annotations

import numpy as np
import pytest

from neuralmusic.errors import InvalidChannelMap, InvalidGeometry
from service.doa.array import MicrophoneArray, speed_of_sound, validate_channel_map

SQUARE = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * 0.02285


@pytest.mark.parametrize(
    ("factor", "hint"), [(1000, "millimetres"), (100, "centimetres"), (0.001, "kilometres")]
)
def test_a_wrong_unit_is_suggested(factor: float, hint: str) -> None:
    with pytest.raises(InvalidGeometry, match=hint):
        MicrophoneArray("custom", SQUARE * factor)


@pytest.mark.parametrize("width", [3.0, 5.4, 12.0])
def test_microphones_in_the_corners_of_a_room_are_refused_for_what_they_are(width: float) -> None:
    corners = np.array([[0, 0, 2.4], [width, 0, 2.4], [width, 3, 2.4], [0, 3, 2.4]])
    with pytest.raises(InvalidGeometry) as refused:
        MicrophoneArray("room", corners)
    crossing = 1000 * np.hypot(width, 3) / 343
    assert f"{crossing:.0f} ms" in refused.value.detail
    assert "in no single direction" in refused.value.detail
    assert "divide by 100 if these are centimetres" in refused.value.detail


def test_coincident_microphones_are_named() -> None:
    positions = np.vstack([SQUARE, SQUARE[2]])
    with pytest.raises(InvalidGeometry, match="microphones 2 and 4"):
        MicrophoneArray("custom", positions)


def test_microphones_above_each_other_hear_no_azimuth() -> None:
    mast = np.array([[0.001 * n, 0.0, 0.05 * n] for n in range(4)])
    with pytest.raises(InvalidGeometry, match=r"seen from above.* 3 mm.* z is up"):
        MicrophoneArray("custom", mast)


@pytest.mark.parametrize("count", [0, 1, 65])
def test_the_number_of_microphones_is_bounded(count: int) -> None:
    positions = np.zeros((count, 3))
    positions[:, 0] = 0.01 * np.arange(count)
    with pytest.raises(InvalidGeometry, match="2 to 64"):
        MicrophoneArray("custom", positions)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_must_be_finite(bad: float) -> None:
    positions = SQUARE.copy()
    positions[1, 1] = bad
    with pytest.raises(InvalidGeometry, match="finite"):
        MicrophoneArray("custom", positions)


def test_positions_must_have_three_coordinates() -> None:
    with pytest.raises(InvalidGeometry, match=r"\[x, y, z\]"):
        MicrophoneArray("custom", SQUARE[:, :2])


def test_aperture_and_kind() -> None:
    square = MicrophoneArray("custom", SQUARE)
    assert square.aperture == pytest.approx(2 * np.sqrt(2) * 0.02285)
    assert not square.linear
    line = MicrophoneArray("custom", np.array([[0, 0.03 * n, 0.0] for n in range(4)]))
    assert line.linear


@pytest.mark.parametrize(
    ("off_mm", "linear"),
    [
        ([0.3, -0.3, 0.2, -0.2], True),  # rounded to whole millimetres
        ([1.2, -1.5, 0.8, -0.5], True),  # measured with a ruler
        ([0, 2, 2, 0], True),  # an arc that is nearly a line
        ([4, -4, 4, -4], False),
        ([0, 8, 8, 0], False),
    ],
)
def test_a_line_is_what_position_errors_make_one(off_mm: list[float], linear: bool) -> None:
    bent = np.array([[0.001 * off, 0.03 * n, 0.0] for n, off in enumerate(off_mm)])
    assert MicrophoneArray("custom", bent).linear is linear
    turned = MicrophoneArray("custom", bent).rotated(1.0)
    assert turned.linear is linear
    if linear:  # steered as the line through them: the images give the same delays
        moved = turned.steered - turned.steered.mean(axis=0)
        assert np.linalg.svd(moved, compute_uv=False)[1] < 1e-12
        assert np.abs(turned.steered - turned.positions).max() < 0.003


def test_the_bounds_themselves_are_allowed() -> None:
    for radius in (0.005, 1.0):
        angles = 0.1 + np.arange(4) * np.pi / 2
        ring = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], axis=1)
        assert MicrophoneArray("ring", ring).aperture == pytest.approx(2 * radius)


def test_a_translated_array_is_the_same_array_and_a_turned_one_is_not() -> None:
    square = MicrophoneArray("custom", SQUARE)
    assert square.matches(MicrophoneArray("elsewhere", np.add(SQUARE, [0.3, -0.1, 1.0])))
    assert not square.matches(square.rotated(np.pi / 2))
    assert square.rotated(2 * np.pi).matches(square)
    assert not square.matches(MicrophoneArray("three", SQUARE[:3]))


def test_positions_cannot_be_changed_afterwards() -> None:
    array = MicrophoneArray("custom", SQUARE)
    with pytest.raises(ValueError, match="read-only"):
        array.positions[0, 0] = 1.0


@pytest.mark.parametrize(
    ("channel_map", "message"),
    [([0, 1, 2], "names 3 channels"), ([0, 1, 1, 2], "twice"), ([0, 1, 2, -1], "negative")],
)
def test_channel_maps_are_checked(channel_map: list[int], message: str) -> None:
    with pytest.raises(InvalidChannelMap, match=message):
        validate_channel_map(channel_map, 4)


def test_speed_of_sound_at_room_temperature() -> None:
    assert speed_of_sound(20.0) == pytest.approx(343.4, abs=0.5)
