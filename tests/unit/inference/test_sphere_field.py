"""Talkers above and below arrays with height, as plane waves whose directions are known."""

from __future__ import annotations

import numpy as np
import pytest

from neuralmusic.protocol.methods import HEMISPHERES, Hemisphere
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.sphere import angle_between
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.bundle import Bundle, load_bundle
from service.inference.registry import EMBEDDED_MODELS
from service.inference.results import WindowEstimate
from service.inference.stream import stream_localizer_of
from service.inference.weights import WeightsLocalizer

TETRAHEDRON = MicrophoneArray(
    "tetrahedron", np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.018
)
SQUARE = preset("respeaker-usb-4mic-v2")
WALL = MicrophoneArray(
    "wall", np.stack([0 * SQUARE.positions[:, 0], *SQUARE.positions.T[:2]], axis=1)
)
"""The square in a wall that faces +x"""
DIRECTIONS = [(20, 60), (130, -45), (215, 10), (300, 80), (350, -20), (75, 35)]
"""Azimuth and elevation in degrees"""


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(EMBEDDED_MODELS / "any-array")


def off_deg(estimate: WindowEstimate, azimuth: float, elevation: float) -> float:
    """Degrees from the only source to a direction in degrees."""
    (source,) = estimate.sources
    assert source.elevation is not None
    found = unit_vectors(np.array(source.azimuth), source.elevation)
    truth = unit_vectors(np.deg2rad(np.array(azimuth)), np.deg2rad(elevation))
    return float(np.rad2deg(angle_between(found, truth)))


@pytest.mark.parametrize(("azimuth", "elevation"), DIRECTIONS)
def test_a_talker_is_found_wherever_it_is(
    bundle: Bundle, plane_waves, azimuth: float, elevation: float
) -> None:
    audio = plane_waves(TETRAHEDRON, [azimuth], elevation_deg=elevation)
    localizer = WeightsLocalizer(bundle, TETRAHEDRON)
    (told,) = localizer.estimate(audio[None], 1, 3)
    assert off_deg(told, azimuth, elevation) < 1.0
    (counted,) = localizer.estimate(audio[None], None, 3)
    assert off_deg(counted, azimuth, elevation) < 1.0
    assert counted.sources[0].confidence > 0.5
    assert told.spectrum.shape == localizer.nothing.spectrum.shape


def test_two_talkers_at_one_azimuth_are_two(bundle: Bundle, plane_waves) -> None:
    audio = sum(
        plane_waves(TETRAHEDRON, [40], elevation_deg=elevation, seed=seed)
        for seed, elevation in ((2, -40), (3, 40))
    )
    (estimate,) = WeightsLocalizer(bundle, TETRAHEDRON).estimate(audio[None], 2, 3)
    found = sorted(np.rad2deg(source.elevation) for source in estimate.sources)
    np.testing.assert_allclose(found, [-40, 40], atol=3)
    np.testing.assert_allclose(
        [np.rad2deg(source.azimuth) for source in estimate.sources], 40, atol=3
    )


@pytest.mark.parametrize("hemisphere", HEMISPHERES)
def test_a_level_array_tells_elevations_where_the_side_is_known(
    bundle: Bundle, plane_waves, hemisphere: Hemisphere
) -> None:
    audio = plane_waves(SQUARE, [110], elevation_deg=50)
    localizer = WeightsLocalizer(bundle, SQUARE, hemisphere=hemisphere)
    (estimate,) = localizer.estimate(audio[None], 1, 3)
    if hemisphere == "both":
        assert estimate.sources[0].elevation is None
    else:
        assert off_deg(estimate, 110, 50 if hemisphere == "upper" else -50) < 2.0


def test_an_array_in_a_wall_hears_azimuths_and_elevations_before_it(
    bundle: Bundle, plane_waves
) -> None:
    audio = plane_waves(WALL, [50], elevation_deg=40)
    (estimate,) = WeightsLocalizer(bundle, WALL).estimate(audio[None], 1, 3)
    assert off_deg(estimate, 50, 40) < 2.0


def test_a_stream_tells_elevations_too(bundle: Bundle, plane_waves) -> None:
    stft = Stft()
    spectra = stft.transform(plane_waves(TETRAHEDRON, [215], elevation_deg=35, seconds=1.0))
    stream = stream_localizer_of("neural", bundle, TETRAHEDRON, stft)
    for part in np.array_split(spectra, 9, axis=-1):
        stream.push(part)
        estimate = stream.estimate(1, 3)
    assert off_deg(estimate, 215, 35) < 3.0  # as found, not refined


def test_silence_has_no_direction(bundle: Bundle) -> None:
    silence: FloatArray = np.zeros((1, 4, 8192), dtype=np.float32)
    (estimate,) = WeightsLocalizer(bundle, TETRAHEDRON).estimate(silence, None, 3)
    assert estimate.sources == ()
    assert np.isfinite(estimate.spectrum).all()
