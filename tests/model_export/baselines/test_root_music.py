"""Root-MUSIC against the analytic angle, and against MUSIC on a dense grid."""

from __future__ import annotations

import numpy as np
import pytest
from plane_waves import plane_waves

from model_export.baselines.root_music import RootMusic, signal_roots, uniform_line
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.evd import noise_projector, signal_subspace
from service.doa.music import music_spectrum
from service.doa.presets import preset
from service.doa.scoring import maae
from service.doa.steering import steering_vectors


def line(count: int = 4, spacing: float = 0.04, axis_deg: float = 90.0) -> MicrophoneArray:
    along = spacing * np.arange(count)[:, None]
    axis = np.deg2rad(axis_deg)
    return MicrophoneArray("line", along * [np.cos(axis), np.sin(axis), 0.0])


@pytest.mark.parametrize(
    ("axis_deg", "azimuth_deg"), [(90.0, [-33.3]), (0.0, [123.4]), (30.0, [-20.0, -100.0])]
)
def test_plane_waves_are_found(axis_deg: float, azimuth_deg: list[float]) -> None:
    array = line(axis_deg=axis_deg)
    estimate = RootMusic().localize(plane_waves(array, azimuth_deg), array, len(azimuth_deg))
    assert np.rad2deg(maae(estimate.azimuth, np.deg2rad(azimuth_deg))) < 0.5


def test_the_order_of_the_microphones_does_not_matter() -> None:
    array = line()
    shuffled = MicrophoneArray("shuffled", array.positions[[2, 0, 3, 1]])
    audio = plane_waves(array, [25.0])
    expected = RootMusic().localize(audio, array, 1).azimuth
    found = RootMusic().localize(audio[[2, 0, 3, 1]], shuffled, 1).azimuth
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_roots_are_the_maxima_of_music_on_a_dense_grid() -> None:
    rng = np.random.default_rng(5)
    array, frequency = line(count=5), 2500.0
    azimuth = np.deg2rad(np.linspace(-90, 90, 18001))
    steering = steering_vectors(array.positions, np.array([frequency]), azimuth)
    sources = steering[0][:, [6500, 11000]]  # -25 and 20 degrees
    shape = (5, 400)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    signals = rng.standard_normal((2, 400)) + 1j * rng.standard_normal((2, 400))
    snapshots = sources @ signals + 0.1 * noise
    covariance = (snapshots @ snapshots.conj().T / 400)[None]
    subspace = signal_subspace(covariance, 2)
    roots = signal_roots(noise_projector(subspace), 2)[0]
    assert (np.abs(roots) < 1).all()
    sine = np.angle(roots) * SPEED_OF_SOUND / (2 * np.pi * frequency * 0.04)
    spectrum = music_spectrum(subspace, steering)[0]
    inner = spectrum[1:-1]
    maxima = np.flatnonzero((inner > spectrum[:-2]) & (inner > spectrum[2:])) + 1
    highest = azimuth[maxima[np.argsort(-spectrum[maxima])[:2]]]
    np.testing.assert_allclose(np.sort(np.arcsin(sine)), np.sort(highest), atol=np.deg2rad(0.1))


def test_a_perfect_subspace_gives_the_analytic_roots() -> None:
    phase = np.array([-1.2, 0.4])
    ideal = np.linalg.qr(np.exp(1j * np.arange(4)[:, None] * phase))[0]
    roots = signal_roots(noise_projector(ideal[None]), 2)[0]
    np.testing.assert_allclose(np.sort(np.angle(roots)), phase, atol=1e-6)


def test_the_band_ends_at_the_spatial_aliasing() -> None:
    assert 31.25 * uniform_line(line(spacing=0.1)).bins[-1] <= SPEED_OF_SOUND / 0.2
    assert 31.25 * uniform_line(line(spacing=0.02)).bins[-1] == 3500


@pytest.mark.parametrize(
    "positions",
    [
        preset("respeaker-usb-4mic-v2").positions,
        [[0, 0, 0], [0.04, 0, 0], [0.09, 0, 0]],
        [[0, 0, 0], [0.04, 0, 0.03], [0.08, 0, 0]],
    ],
    ids=["square", "uneven", "a panel"],
)
def test_other_arrays_are_refused(positions: list[list[float]]) -> None:
    array = MicrophoneArray("other", np.array(positions))
    audio = np.ones((array.num_microphones, 2048), np.float32)
    with pytest.raises(ValueError, match="equal distances on one line"):
        RootMusic().localize(audio, array, 1)
