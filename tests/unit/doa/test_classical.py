"""The classical methods against pyroomacoustics' on the same spectra."""

from __future__ import annotations

import numpy as np
import pyroomacoustics as pra
import pytest

from service.doa import classical
from service.doa.covariance import sample_covariance
from service.doa.pair_products import PairProducts
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray

STFT = Stft()
BAND = np.flatnonzero((STFT.frequencies >= 500) & (STFT.frequencies <= 3500))


def noisy_scene(seed: int, num_sources: int) -> ComplexArray:
    """Broadband sources with random amplitudes in noise, (N, 257, 40) complex64."""
    rng = np.random.default_rng(seed)
    positions = preset("respeaker-usb-4mic-v2").positions
    azimuths = rng.uniform(0, 2 * np.pi, num_sources)
    steering = steering_vectors(positions, STFT.frequencies, azimuths)  # (F, N, M)
    shape = (257, num_sources, 40)
    amplitudes = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    noise = rng.standard_normal((257, 4, 40)) + 1j * rng.standard_normal((257, 4, 40))
    return np.moveaxis(steering @ amplitudes + 0.3 * noise, 1, 0).astype(np.complex64)


def reference(name: str, spectra: ComplexArray, num_sources: int) -> FloatArray:
    positions = preset("respeaker-usb-4mic-v2").positions
    method = pra.doa.algorithms[name](
        positions.T, 16000, 512, c=343.0, num_src=num_sources, n_grid=360, dim=2
    )
    method.locate_sources(spectra, num_src=num_sources, freq_bins=BAND)
    values: FloatArray = method.grid.values
    return values


@pytest.mark.parametrize("num_sources", [1, 2])
@pytest.mark.parametrize(
    ("ours", "theirs"), [("music", "MUSIC"), ("norm_music", "NormMUSIC"), ("srp_phat", "SRP")]
)
def test_spectra_agree_with_pyroomacoustics(ours: str, theirs: str, num_sources: int) -> None:
    spectra = noisy_scene(10 + num_sources, num_sources)
    positions = preset("respeaker-usb-4mic-v2").positions
    steering = steering_vectors(positions, STFT.frequencies[BAND], azimuth_grid())
    band = spectra[:, BAND]
    if ours == "srp_phat":
        spectrum = classical.srp_phat(sample_covariance(classical.phase_transform(band)), steering)
    else:
        spectrum = getattr(classical, ours)(sample_covariance(band), steering, num_sources)
    expected = reference(theirs, spectra, num_sources)
    # Each library scales its spectrum in its own way (SRP also by an offset); shapes must agree.
    np.testing.assert_allclose(scaled(spectrum), scaled(expected), atol=2e-3)


def test_gcc_phat_is_the_pairs_correlations_at_the_azimuths_delays() -> None:
    """The truth transforms every pair's whitened cross-spectrum back, one delay at a time."""
    positions = preset("respeaker-usb-4mic-v2").positions
    frequencies = STFT.frequencies[BAND]
    covariance = sample_covariance(noisy_scene(3, 1)[:, BAND])
    azimuths = azimuth_grid()[::30]
    expected = np.zeros(len(azimuths))
    for place, azimuth in enumerate(azimuths):
        towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
            lead = (positions[i] - positions[j]) @ towards / 343.0
            phase = np.angle(covariance[:, i, j]) - 2 * np.pi * frequencies * lead
            expected[place] += np.cos(phase).mean() / 6
    steering = steering_vectors(positions, frequencies, azimuths)
    np.testing.assert_allclose(classical.gcc_phat(covariance, steering), expected, atol=1e-4)
    products = PairProducts(steering)
    shared = classical.gcc_phat(covariance, steering, products)
    np.testing.assert_allclose(shared, expected, atol=1e-4)


def scaled(spectrum: FloatArray) -> FloatArray:
    low, high = spectrum.min(), spectrum.max()
    result: FloatArray = (spectrum - low) / (high - low)
    return result
