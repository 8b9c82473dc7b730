"""Fusion, weighted covariances and features: properties that follow from their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from service.doa.covariance import chosen_and_sum, weighted_covariance
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.fusion import attention_fusion, attention_weights, mean_fusion, normalise
from service.doa.steering import steering_vectors
from service.doa.types import ComplexArray, FloatArray


def random_spectra(seed: int, *shape: int) -> ComplexArray:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def unit(spectra: ComplexArray) -> ComplexArray:
    return unit_vectors_and_power(spectra)[0]


def features_of(spectra: ComplexArray) -> FloatArray:
    return coherence_features(*unit_vectors_and_power(spectra))


def test_fusion_is_a_weighted_mean() -> None:
    rng = np.random.default_rng(1)
    spectra = rng.uniform(0, 1, (20, 36)).astype(np.float32)
    attention = rng.uniform(0, 1, 20).astype(np.float32)
    fused = attention_fusion(spectra, attention)
    np.testing.assert_allclose(fused, np.average(spectra, axis=0, weights=attention), rtol=1e-5)
    equal = attention_fusion(spectra, np.full(20, 0.3, np.float32))
    np.testing.assert_allclose(equal, mean_fusion(spectra), rtol=1e-5)


def test_no_attention_gives_a_zero_spectrum() -> None:
    assert (attention_fusion(np.ones((5, 8), np.float32), np.zeros(5, np.float32)) == 0).all()


def test_attention_follows_the_pooled_spectra() -> None:
    """Bins whose spectra are flat pool to more; with identity layers they get more attention."""
    spectra = normalise(np.stack([np.ones(36), np.eye(36)[3] + 1e-3]).astype(np.float32))
    attention = attention_weights(spectra, np.eye(2, dtype=np.float32), np.eye(2, dtype=np.float32))
    assert attention[0] == pytest.approx(1 / (1 + np.exp(-1)))
    assert 0.5 < attention[1] < 0.52


@pytest.mark.parametrize("microphones", [2, 4, 5, 8])
def test_weighted_covariance_is_hermitian_with_unit_frames(microphones: int) -> None:
    spectra = random_spectra(2, microphones, 10, 16)
    weights = np.random.default_rng(3).uniform(0, 1, (10, 16)).astype(np.float32)
    covariance = weighted_covariance(unit(spectra), weights, 8)
    assert covariance.shape == (2, 10, microphones, microphones)
    np.testing.assert_allclose(covariance, covariance.conj().swapaxes(-1, -2), atol=1e-6)
    # Frames have unit norm, so the trace is the sum of the block's weights.
    trace = np.trace(covariance, axis1=-2, axis2=-1).real
    np.testing.assert_allclose(trace, weights.reshape(10, 2, 8).sum(axis=-1).T, rtol=1e-4)
    norm = spectra / np.linalg.norm(spectra, axis=0)
    expected = np.einsum("nfl,mfl,fl->lfnm", norm, norm.conj(), weights)
    np.testing.assert_allclose(covariance[1], expected[8:].sum(axis=0), atol=1e-5)


@pytest.mark.parametrize("microphones", [4, 8])
def test_chosen_blocks_and_the_sum_of_all(microphones: int) -> None:
    spectra = unit(random_spectra(2, microphones, 10, 24))
    rng = np.random.default_rng(3)
    weights = rng.uniform(0, 1, (10, 24)).astype(np.float32)
    chosen = np.stack([rng.permutation(3)[:2] for _ in range(10)], axis=1)
    blocks = weighted_covariance(spectra, weights, 8)
    cells = chosen_and_sum(blocks, chosen)
    assert cells.shape == (3, 10, microphones, microphones)
    for row, f in np.ndindex(2, 10):
        np.testing.assert_array_equal(cells[row, f], blocks[chosen[row, f], f])
    window = weighted_covariance(spectra, weights, 24)
    np.testing.assert_allclose(cells[2], window[0], rtol=1e-3, atol=1e-5)


def test_a_weight_of_zero_removes_a_frame() -> None:
    spectra = random_spectra(4, 3, 5, 8)
    weights = np.ones((5, 8), np.float32)
    weights[:, 3] = 0
    changed = spectra.copy()
    changed[..., 3] = random_spectra(5, 3, 5)
    np.testing.assert_allclose(
        weighted_covariance(unit(spectra), weights, 8),
        weighted_covariance(unit(changed), weights, 8),
    )


def test_features_ignore_level_order_and_array_phase() -> None:
    spectra = random_spectra(6, 4, 12, 10)
    features = features_of(spectra)
    assert features.shape == (5, 12, 10)
    np.testing.assert_allclose(features_of(spectra * 37), features, atol=2e-4)
    np.testing.assert_allclose(features_of(spectra[[2, 0, 3, 1]]), features, atol=2e-4)
    # Another place of the microphones is a phase per microphone and bin.
    turned = spectra * np.exp(1j * np.random.default_rng(7).uniform(0, 6, (4, 12, 1)))
    turned_features = features_of(turned.astype(np.complex64))
    # Only from bin to bin does it show, and there as little as the array is small.
    np.testing.assert_allclose(turned_features[:4], features[:4], atol=2e-4)


def test_a_steady_direction_is_coherent_and_noise_is_not() -> None:
    amplitude = random_spectra(8, 1, 40, 30)
    steady = features_of(amplitude * random_spectra(9, 4, 40, 1))
    np.testing.assert_allclose(steady[2, :, 1:], 1.0, atol=1e-4)
    np.testing.assert_allclose(steady[3, :, 2:], 1.0, atol=1e-4)
    noise = features_of(random_spectra(10, 4, 40, 30))
    # E|x^H y| of random unit vectors in C^4 is Gamma(4) Gamma(3/2) / Gamma(9/2) = 0.457.
    assert noise[2, :, 1:].mean() == pytest.approx(0.457, abs=0.02)
    assert noise[4, 2:].mean() == pytest.approx(0.457, abs=0.02)


def test_a_plane_wave_is_coherent_from_bin_to_bin_on_any_board_of_a_robot() -> None:
    # Two bins are 62 Hz: over 20 cm a plane wave's phase turns by 0.23 at most.
    positions = np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.1, 0], [0, -0.1, 0]])
    steering = steering_vectors(positions, np.arange(40) * 31.25, np.array([0.4]))  # (F, N, 1)
    wave = np.swapaxes(steering, 0, 1) * random_spectra(11, 1, 40, 30)
    assert features_of(wave.astype(np.complex64))[4, 2:].min() > 0.97


def test_digital_silence_has_finite_features() -> None:
    features = features_of(np.zeros((4, 12, 10), np.complex64))
    assert np.isfinite(features).all()
