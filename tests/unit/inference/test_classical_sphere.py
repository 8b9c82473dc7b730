"""The classical methods on the sphere, beside pyroomacoustics' on the same directions."""

from __future__ import annotations

import numpy as np
import pyroomacoustics as pra
import pytest
from pyroomacoustics.doa.doa import ModeVector
from pyroomacoustics.doa.grid import GridSphere

from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.sphere import angle_between, whole_sphere
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray
from service.inference.classical import BAND, ClassicalLocalizer
from service.inference.results import Source
from service.inference.stream import stream_localizer_of

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
TETRAHEDRON = MicrophoneArray("tetrahedron", CORNERS * 0.018)
CUBE = MicrophoneArray("cube", np.concatenate([CORNERS, -CORNERS]) * 0.02)
SQUARE = preset("respeaker-usb-4mic-v2")
WALL = MicrophoneArray("wall", SQUARE.positions[:, [2, 0, 1]])
"""The square in a wall that faces +x"""
STFT = Stft()
METHODS: tuple[tuple[Method, str], ...] = (
    ("norm_music", "NormMUSIC"),
    ("music", "MUSIC"),
    ("srp_phat", "SRP"),
)


def towards(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def off_deg(source: Source, azimuth_deg: float, elevation_deg: float) -> float:
    assert source.elevation is not None
    found = towards(np.rad2deg(source.azimuth), np.rad2deg(source.elevation))
    return float(np.rad2deg(angle_between(found, towards(azimuth_deg, elevation_deg))))


def reference(
    name: str, array: MicrophoneArray, directions: FloatArray, spectra: ComplexArray, count: int
) -> FloatArray:
    """pyroomacoustics' spectrum (D,) in directions (D, 3)."""
    method = pra.doa.algorithms[name](
        array.positions.T, 16000, 512, c=343.0, num_src=count, dim=3, n_grid=len(directions)
    )
    # Its constructor takes azimuths and colatitudes for their product alone.
    method.grid = GridSphere(cartesian_points=directions.T)
    method.mode_vec = ModeVector(array.positions.T, 16000, 512, 343.0, method.grid)
    bins = np.flatnonzero((STFT.frequencies >= BAND[0]) & (STFT.frequencies <= BAND[1]))
    method.locate_sources(spectra, num_src=count, freq_bins=bins)
    values: FloatArray = method.grid.values
    return values


def scaled(spectrum: FloatArray) -> FloatArray:
    """Each library has a scale, and for SRP an offset, of its own; shapes must agree."""
    low, high = spectrum.min(), spectrum.max()
    result: FloatArray = (spectrum - low) / (high - low)
    return result


@pytest.mark.parametrize(("method", "theirs"), METHODS)
@pytest.mark.parametrize("array", [TETRAHEDRON, CUBE], ids=lambda array: array.name)
def test_spectra_on_the_sphere_are_those_of_pyroomacoustics(
    method: Method, theirs: str, array: MicrophoneArray, plane_waves
) -> None:
    first = plane_waves(array, [70], elevation_deg=40, snr_db=15, seed=2)
    spectra = STFT.transform(first + plane_waves(array, [220], elevation_deg=-30, seed=3))
    localizer = ClassicalLocalizer(method, array)
    for count in (1, 2):
        ours = localizer.spectrum(localizer.covariance(spectra), count)
        expected = reference(theirs, array, whole_sphere().vectors, spectra, count)
        np.testing.assert_allclose(scaled(ours), scaled(expected), atol=1e-2)


@pytest.mark.parametrize(("method", "theirs"), METHODS)
def test_a_direction_is_where_pyroomacoustics_has_its_maximum_on_a_fine_grid(
    method: Method, theirs: str, plane_waves
) -> None:
    """Half a degree apart, where the service's own grid has eight."""
    audio = plane_waves(CUBE, [123], elevation_deg=37, snr_db=10)
    (estimate,) = ClassicalLocalizer(method, CUBE).estimate(audio[None], 1, 3)
    fine = np.array(
        [towards(a, e) for a in np.arange(113, 133, 0.5) for e in np.arange(29, 45, 0.5)]
    )
    values = reference(theirs, CUBE, fine, STFT.transform(audio), 1)
    x, y, z = fine[values.argmax()]
    best = np.rad2deg([np.arctan2(y, x), np.arcsin(z)])
    assert off_deg(estimate.sources[0], *best) < 1.0


@pytest.mark.parametrize("method", [*(name for name, _ in METHODS), "gcc_phat"])
@pytest.mark.parametrize(("azimuth", "elevation"), [(20, 60), (130, -45), (300, 80), (215, 10)])
def test_talkers_are_found_above_and_below(
    method: Method, azimuth: float, elevation: float, plane_waves
) -> None:
    audio = plane_waves(TETRAHEDRON, [azimuth], elevation_deg=elevation)
    localizer = ClassicalLocalizer(method, TETRAHEDRON)
    (told,) = localizer.estimate(audio[None], 1, 3)
    assert off_deg(told.sources[0], azimuth, elevation) < 1.5
    (counted,) = localizer.estimate(audio[None], None, 3)
    assert off_deg(counted.sources[0], azimuth, elevation) < 1.5
    assert counted.sources[0].confidence > 0.5
    stream = stream_localizer_of(method, None, TETRAHEDRON, STFT)
    for part in np.array_split(STFT.transform(audio), 5, axis=-1):
        stream.push(part)
    assert off_deg(stream.estimate(1, 3).sources[0], azimuth, elevation) < 3.0


@pytest.mark.parametrize("hemisphere", ["both", "upper", "lower"])
def test_sides_are_told_as_for_networks(hemisphere: Hemisphere, plane_waves) -> None:
    audio = plane_waves(SQUARE, [110], elevation_deg=50)
    (estimate,) = ClassicalLocalizer("norm_music", SQUARE, hemisphere=hemisphere).estimate(
        audio[None], 1, 3
    )
    (source,) = estimate.sources
    if hemisphere == "both":
        assert source.elevation is None
        assert estimate.sphere is None
        assert estimate.spectrum.shape == (360,)
    else:
        assert off_deg(source, 110, 50 if hemisphere == "upper" else -50) < 3.0
    before = plane_waves(WALL, [50], elevation_deg=40)
    (estimate,) = ClassicalLocalizer("srp_phat", WALL).estimate(before[None], 1, 3)
    assert off_deg(estimate.sources[0], 50, 40) < 3.0


@pytest.mark.parametrize("method", [*(name for name, _ in METHODS), "gcc_phat"])
def test_white_noise_has_no_direction_on_the_sphere(method: Method) -> None:
    localizer = ClassicalLocalizer(method, TETRAHEDRON)
    rng = np.random.default_rng(0)
    noise = (0.01 * rng.standard_normal((6, 4, 16640))).astype(np.float32)
    assert not any(each.sources for each in localizer.estimate(noise, None, 3))
