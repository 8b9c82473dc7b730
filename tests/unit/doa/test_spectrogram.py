"""The regression network's features against what they are defined to mean."""

from __future__ import annotations

import numpy as np
import pytest

from service.doa.features import LEVEL_SCALE
from service.doa.spectrogram import PhaseReference, spectrogram_features
from service.doa.types import ComplexArray

REFERENCES: tuple[PhaseReference, ...] = ("absolute", "first")


def random_spectra(*shape: int, seed: int = 0) -> ComplexArray:
    rng = np.random.default_rng(seed)
    spectra: ComplexArray = (rng.standard_normal((*shape, 2)) @ np.array([1, 1j])).astype(
        np.complex64
    )
    return spectra


@pytest.mark.parametrize("reference", REFERENCES)
def test_two_finite_features_per_microphone_whatever_the_batch(reference: PhaseReference) -> None:
    spectra = random_spectra(2, 3, 4, 9, 6)
    features = spectrogram_features(spectra, reference)
    assert features.shape == (2, 3, 8, 9, 6)
    assert features.dtype == np.float32
    assert np.isfinite(features).all()
    np.testing.assert_allclose(
        features[1, 2], spectrogram_features(spectra[1, 2], reference), atol=1e-6
    )


@pytest.mark.parametrize("reference", REFERENCES)
def test_the_recording_s_gain_cancels(reference: PhaseReference) -> None:
    spectra = random_spectra(4, 9, 6)
    features = spectrogram_features(spectra, reference)
    np.testing.assert_allclose(spectrogram_features(300 * spectra, reference), features, atol=1e-4)


@pytest.mark.parametrize("reference", REFERENCES)
def test_silence_and_a_dead_microphone_give_finite_features(reference: PhaseReference) -> None:
    spectra = random_spectra(4, 9, 6)
    spectra[0] = 0
    assert np.isfinite(spectrogram_features(spectra, reference)).all()
    assert np.isfinite(spectrogram_features(np.zeros_like(spectra), reference)).all()


def test_level_differences_between_microphones_stay() -> None:
    spectra = random_spectra(4, 9, 6)
    spectra[1] = 2 * spectra[0]
    features = spectrogram_features(spectra, "absolute")
    np.testing.assert_allclose(features[1] - features[0], LEVEL_SCALE * np.log(4), atol=1e-3)


def test_absolute_phases_are_wrapped_and_in_units_of_pi() -> None:
    spectra = np.exp(1j * np.pi * np.array([0.0, 0.5, -0.25, 1.25])).astype(np.complex64)
    features = spectrogram_features(spectra[:, None, None], "absolute")
    np.testing.assert_allclose(features[4:, 0, 0], [0, 0.5, -0.25, -0.75], atol=1e-6)


def test_features_relative_to_the_first_microphone_ignore_the_common_phase() -> None:
    spectra = random_spectra(4, 9, 6)
    turned = spectra * np.exp(1j * np.random.default_rng(1).uniform(0, 6, (9, 6)))
    features = spectrogram_features(spectra, "first")
    np.testing.assert_allclose(spectrogram_features(turned, "first"), features, atol=1e-5)


def test_features_relative_to_the_first_microphone_hold_the_channel_vector() -> None:
    spectra = random_spectra(4, 9, 6)
    features = spectrogram_features(spectra, "first")
    imaginary = np.concatenate([np.zeros((1, 9, 6)), features[5:]])
    unit = features[:4] + 1j * imaginary
    np.testing.assert_allclose(np.linalg.norm(unit, axis=0), 1, atol=1e-5)
    correlation = np.abs(np.sum(unit.conj() * spectra, axis=0)) / np.linalg.norm(spectra, axis=0)
    np.testing.assert_allclose(correlation, 1, atol=1e-5)
    assert (features[0] >= 0).all()


def test_a_level_exponent_scales_the_channel_vector_and_nothing_else() -> None:
    spectra = random_spectra(4, 64, 64)
    spectra[:, 0, 0] *= 1000  # above the bound
    spectra[:, 1] *= 0.01
    plain, features = (spectrogram_features(spectra, "first", e) for e in (0.0, 0.15))
    power = np.sum(np.abs(spectra) ** 2, axis=0)
    expected = np.minimum((power / power.mean()) ** 0.15, 3)
    assert expected[0, 0] == 3
    assert 0 < expected[1].max() < 0.2
    np.testing.assert_array_equal(features[4], plain[4])
    vectors, unit = (np.delete(each, 4, axis=0) for each in (features, plain))
    np.testing.assert_allclose(vectors, expected * unit, rtol=1e-4, atol=1e-6)
