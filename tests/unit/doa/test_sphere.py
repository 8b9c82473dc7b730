"""Grids of directions: even, closed, and exact where a paraboloid or a plane wave is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.doa.array import MicrophoneArray
from service.doa.hemisphere import searched_directions, why_no_elevation, why_one_side
from service.doa.presets import preset
from service.doa.sphere import (
    angle_between,
    azimuth_elevation,
    half_sphere,
    on_sphere,
    tangents,
    whole_sphere,
)
from service.doa.steering import (
    azimuth_grid,
    direction_steering,
    resolution,
    sphere_resolution,
    steering_vectors,
    unit_vectors,
)
from service.doa.types import FloatArray

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.018
SQUARE = preset("respeaker-usb-4mic-v2").positions
azimuths = st.floats(0, 2 * np.pi, exclude_max=True)
elevations = st.floats(-np.pi / 2, np.pi / 2)


def upright(positions: FloatArray) -> FloatArray:
    """A level array turned on its edge: its x becomes z."""
    return np.stack([np.zeros(len(positions)), positions[:, 1], positions[:, 0]], axis=1)


def direction(azimuth: float, elevation: float) -> FloatArray:
    return unit_vectors(np.array(azimuth), elevation)


def test_the_grid_covers_the_sphere_evenly_and_in_opposite_pairs() -> None:
    grid = whole_sphere()
    assert grid.size == 642
    np.testing.assert_allclose(np.linalg.norm(grid.vectors, axis=1), 1)
    np.testing.assert_array_equal(grid.vectors[321:], -grid.vectors[:321])
    anywhere = np.random.default_rng(0).normal(size=(4000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    farthest = np.rad2deg(np.arccos((anywhere @ grid.vectors.T).max(axis=1))).max()
    assert farthest < 6  # of 642 caps of equal area each has a radius of 4.5 degrees


@given(azimuth=azimuths, elevation=elevations)
def test_a_direction_survives_its_angles_and_its_tangents_are_square_to_it(
    azimuth: float, elevation: float
) -> None:
    vector = direction(azimuth, elevation)
    back = direction(*azimuth_elevation(vector))
    assert angle_between(vector, back) < 1e-7
    axes = np.array([vector, *tangents(vector)])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert tangents(vector)[1][2] >= 0  # upwards
    place = np.array([0.1, -0.2])
    moved = on_sphere(vector, axes[1:], place)
    assert angle_between(vector, moved) == pytest.approx(np.hypot(*place), abs=1e-9)


@given(azimuth=azimuths, elevation=elevations)
def test_a_peak_of_known_shape_is_met_between_the_grid_s_directions(
    azimuth: float, elevation: float
) -> None:
    grid, truth = whole_sphere(), direction(azimuth, elevation)
    spectrum = 1 / (0.1 + np.square(angle_between(grid.vectors, truth[None])))
    (highest, *others) = grid.peaks(spectrum, 3)
    assert not others
    found = grid.vertex(spectrum, highest)
    assert np.rad2deg(angle_between(found, truth)) < 1.0  # the grid's own error reaches 5.4


def test_maxima_that_are_close_are_one_and_a_constant_has_none() -> None:
    grid = whole_sphere()
    spectrum = np.zeros(grid.size)
    assert grid.peaks(spectrum, 3) == []
    far = int(np.argmin(grid.vectors @ grid.vectors[0]))
    spectrum[0], spectrum[grid.neighbours[0][0]], spectrum[far] = 1.0, 0.9, 0.5
    assert grid.peaks(spectrum, 3) == [0, far]


def test_the_spectrum_of_azimuths_is_the_highest_of_every_elevation() -> None:
    grid = whole_sphere()
    for azimuth, elevation in ((0.3, 0.0), (2.0, 0.9), (5.1, -0.7)):
        truth = direction(azimuth, elevation)
        spectrum = 1 / (0.05 + np.square(angle_between(grid.vectors, truth[None])))
        flat = grid.azimuth_spectrum(spectrum)
        off = azimuth_grid(len(flat))[flat.argmax()] - azimuth
        assert abs(np.rad2deg(np.arctan2(np.sin(off), np.cos(off)))) < 9
        assert 0.5 * spectrum.max() < flat.max() <= spectrum.max()


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(40, 62.5), (355, -2.5), (0, -87.5)])
def test_an_image_has_rows_of_elevations_and_columns_of_azimuths(
    azimuth_deg: float, elevation_deg: float
) -> None:
    grid = whole_sphere()
    truth = direction(math.radians(azimuth_deg), math.radians(elevation_deg))
    image = grid.image(np.exp(8 * (grid.vectors @ truth - 1)))
    assert image.shape == (36, 72)
    row, column = np.unravel_index(image.argmax(), image.shape)
    seen = direction(math.radians(5 * column), math.radians(5 * row - 87.5))
    assert np.rad2deg(angle_between(seen, truth)) < 6
    assert 0.9 < image.max() <= 1


def test_an_image_is_zero_where_nothing_is_searched() -> None:
    half = half_sphere(np.array([1.0, 0.0, 0.0]))  # ahead
    image = half.image(np.ones(half.size))
    ahead = np.cos(np.deg2rad(np.arange(0, 360, 5))) >= -1e-9
    np.testing.assert_allclose(image, np.tile(ahead.astype(float), (36, 1)), atol=1e-5)


def test_steering_vectors_of_directions_are_those_of_their_angles() -> None:
    frequencies = np.array([500.0, 7900.0])
    azimuth, elevation = np.array([0.2, 3.0]), np.array([-1.0, 0.7])
    exact = steering_vectors(TETRAHEDRON, frequencies, azimuth, elevation=elevation)
    fast = direction_steering(TETRAHEDRON, frequencies, unit_vectors(azimuth, elevation))
    np.testing.assert_allclose(fast, exact, atol=2e-6)


def test_the_resolution_of_the_sphere_is_the_mean_over_all_pairs_of_directions() -> None:
    frequencies = np.array([1000.0, 4000.0])
    steering = direction_steering(TETRAHEDRON, frequencies, whole_sphere().vectors)
    likeness = np.square(np.abs(np.swapaxes(np.conj(steering), 1, 2) @ steering) / 4)
    assert sphere_resolution(TETRAHEDRON, frequencies) == pytest.approx(
        1 - likeness.mean(), abs=2e-3
    )
    # A ring hears less of the sphere than of its own circle.
    assert sphere_resolution(SQUARE, frequencies) < resolution(SQUARE, frequencies)


@pytest.mark.parametrize(
    ("positions", "hemisphere", "size"),
    [
        (TETRAHEDRON, "both", 642),
        (TETRAHEDRON, "upper", half_sphere(np.array([0, 0, 1.0])).size),
        (SQUARE, "both", None),
        (SQUARE, "upper", half_sphere(np.array([0, 0, 1.0])).size),
        (SQUARE, "lower", half_sphere(np.array([0, 0, 1.0])).size),
        (SQUARE + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0.003]]), "both", None),
        (upright(SQUARE), "both", half_sphere(np.array([1.0, 0, 0])).size),
        (np.array([[0, y, 0] for y in (0.0, 0.04, 0.08)]), "upper", None),
    ],
)
def test_an_array_is_searched_where_it_tells_directions_apart(
    positions: FloatArray, hemisphere: str, size: int | None
) -> None:
    grid = searched_directions(MicrophoneArray("of the test", positions), hemisphere)  # type: ignore[arg-type]
    assert (grid and grid.size) == size
    if grid is not None and hemisphere != "both":
        side = 1 if hemisphere == "upper" else -1
        assert (side * grid.vectors[:, 2] >= -1e-6).all()


def test_an_upright_array_is_searched_on_the_side_towards_x() -> None:
    grid = searched_directions(MicrophoneArray("wall", upright(SQUARE)))
    assert grid is not None
    assert (grid.vectors[:, 0] >= -1e-6).all()


@pytest.mark.parametrize("hemisphere", ["both", "upper", "lower"])
def test_a_wall_is_heard_from_before_whatever_the_hemisphere(hemisphere: str) -> None:
    """Its sides are front and back: a hemisphere decides nothing."""
    for lean in (-0.01, 0.0, 0.01):
        wall = upright(SQUARE)
        wall[:, 0] += lean * wall[:, 2]
        grid = searched_directions(MicrophoneArray("wall", wall), hemisphere)  # type: ignore[arg-type]
        assert grid is not None
        assert (grid.vectors[:, 0] >= -0.02).all()


@pytest.mark.parametrize(
    ("lean_deg", "elevations", "says"),
    [
        (0, True, "one line, seen from above"),
        (0, False, "one line, seen from above"),
        (20, True, "one steep plane"),
        (20, False, None),  # seen from above it is no line, and level directions are searched
        (70, True, None),  # level: its images are above and below
        (90, True, None),
    ],
)
def test_a_plane_that_leans_has_a_front_too(
    lean_deg: float, elevations: bool, says: str | None
) -> None:
    lean = np.deg2rad(lean_deg)
    flat = upright(SQUARE * 2)
    flat[:, 0], flat[:, 2] = np.sin(lean) * flat[:, 2], np.cos(lean) * flat[:, 2]
    why = why_one_side(MicrophoneArray("panel", flat), elevations=elevations)
    assert (why is None) if says is None else (why is not None and says in why)


def test_a_line_tells_the_azimuth_of_a_cone() -> None:
    """Also one whose positions were rounded to millimetres, and two microphones."""
    bent = np.array([[0, 0, 0], [0.001, 0.03, 0], [0, 0.06, 0.001], [0, 0.09, 0]])
    for positions in (bent, bent[[0, 3]]):
        line = MicrophoneArray("line", positions)
        assert "cone about the line" in (why_one_side(line, elevations=True) or "")
        assert why_no_elevation(line, "upper") is not None


def test_height_that_rulers_measure_tells_no_elevation() -> None:
    """A third extent of a few millimetres is an error of the positions, in small arrays as well."""
    small = np.array([[0, 0, 0], [0.015, 0, 0.004], [0.015, 0.015, 0], [0, 0.015, 0.004]])
    assert searched_directions(MicrophoneArray("small", small)) is None
    raised = small * [1, 1, 2]
    assert searched_directions(MicrophoneArray("raised", raised)) is not None
