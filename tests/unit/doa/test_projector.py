"""Projectors without eigenvectors against LAPACK's eigenvectors in double precision."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuralmusic.errors import TooManySources
from service.doa import classical
from service.doa.pair_products import pair_products
from service.doa.presets import preset
from service.doa.projector import signal_projector
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray


def with_eigenvalues(values: FloatArray, seed: int = 0) -> tuple[ComplexArray, ComplexArray]:
    """Matrices (F, N, N) of eigenvalues (F, N) and random eigenvectors (F, N, N)."""
    rng = np.random.default_rng(seed)
    shape = (*values.shape, values.shape[-1])
    vectors, _ = np.linalg.qr(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    return (vectors * values[:, None]) @ adjoint(vectors), vectors


def adjoint(matrices: ComplexArray) -> ComplexArray:
    return np.conj(np.swapaxes(matrices, -1, -2))


def projector_of(covariance: ComplexArray, num_sources: int) -> ComplexArray:
    """(F, N, N), as matrices."""
    return signal_projector(covariance, num_sources).transpose(2, 0, 1)


@settings(deadline=None)
@given(
    microphones=st.integers(2, 4),
    num_sources=st.integers(1, 3),
    signal=st.lists(st.floats(-1, 2), min_size=3, max_size=3),
    noise=st.lists(st.floats(-3, -1.3), min_size=3, max_size=3),
    scale=st.floats(-20, 20),
    seed=st.integers(0, 2**32 - 1),
)
def test_it_projects_on_the_largest_eigenvectors(
    microphones: int,
    num_sources: int,
    signal: list[float],
    noise: list[float],
    scale: float,
    seed: int,
) -> None:
    num_sources = min(num_sources, microphones - 1)
    exponents = [*signal[:num_sources], *noise[: microphones - num_sources]]
    values = 10.0 ** (np.array([exponents]) + scale)
    covariance, vectors = with_eigenvalues(values, seed)
    expected = vectors[..., :num_sources] @ adjoint(vectors[..., :num_sources])
    np.testing.assert_allclose(projector_of(covariance, num_sources), expected, atol=2e-3)


@pytest.mark.parametrize("num_sources", [1, 2])
def test_it_is_closer_than_eigenvectors_in_single_precision(num_sources: int) -> None:
    """The matrices are sample covariances of 64 frames: noise and two talkers 20 dB apart."""
    rng = np.random.default_rng(1)
    shape = (300, 4, 64)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    talkers = rng.standard_normal((300, 4, 2)) @ rng.standard_normal((300, 2, 64))
    frames = talkers * 10 + noise
    covariance = (frames @ adjoint(frames)).astype(np.complex64)
    _, vectors = np.linalg.eigh(covariance.astype(complex))
    exact = vectors[..., -num_sources:] @ adjoint(vectors[..., -num_sources:])
    _, single = np.linalg.eigh(covariance)
    by_single = single[..., -num_sources:] @ adjoint(single[..., -num_sources:])
    worst = np.abs(projector_of(covariance, num_sources) - exact).max()
    assert worst < 0.1 * np.abs(by_single - exact).max()


@pytest.mark.parametrize("num_sources", [1, 2, 3])
@pytest.mark.parametrize(
    "values",
    [(0, 0, 0, 0), (1, 1, 1, 1), (1, 0, 0, 0), (1, 1, 0, 0), (1, 1, 1, 0), (1, 1e-6, 1e-6, 1e-6)],
)
def test_without_a_gap_it_is_some_projector_that_holds_what_is_larger(
    values: tuple[float, ...], num_sources: int
) -> None:
    covariance, vectors = with_eigenvalues(np.tile(values, (50, 1)))
    projector = projector_of(covariance, num_sources)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-4)
    np.testing.assert_allclose(np.trace(projector, axis1=1, axis2=2), num_sources, atol=1e-4)
    larger = np.array(values) > values[num_sources]
    held = np.linalg.norm(projector @ vectors[..., larger], axis=1)
    np.testing.assert_allclose(held, 1, atol=1e-3)


def test_bins_without_a_gap_leave_the_others_alone() -> None:
    values = np.array([[1, 0.1, 1e-3, 1e-4], [1, 1, 1, 1], [0, 0, 0, 0], [1, 0.5, 0.01, 0.01]])
    covariance, vectors = with_eigenvalues(values)
    projector = projector_of(covariance, 2)
    for clear in (0, 3):
        expected = vectors[clear, :, :2] @ adjoint(vectors[clear, :, :2])
        np.testing.assert_allclose(projector[clear], expected, atol=1e-6)


@pytest.mark.parametrize("num_sources", [0, 4])
def test_more_sources_than_the_array_tells_apart_are_refused(num_sources: int) -> None:
    with pytest.raises(TooManySources):
        signal_projector(np.eye(4, dtype=np.complex64)[None], num_sources)


@pytest.mark.parametrize("num_sources", [1, 2, 3])
@pytest.mark.parametrize("method", [classical.music, classical.norm_music])
def test_the_classical_spectra_are_those_of_eigenvectors(
    method: Callable[..., FloatArray], num_sources: int
) -> None:
    """What the shorter way gives against the longer one in double precision."""
    rng = np.random.default_rng(2)
    frequencies = np.linspace(300.0, 3500.0, 40)
    positions = preset("respeaker-usb-4mic-v2").positions
    steering = steering_vectors(positions, frequencies, azimuth_grid(120))
    frames = rng.standard_normal((40, 4, 64)) + 1j * rng.standard_normal((40, 4, 64))
    frames += 10 * steering[:, :, 30, None] * rng.standard_normal((40, 1, 64))
    covariance = (frames @ adjoint(frames)).astype(np.complex64)
    products = pair_products(steering)
    expected = method(covariance.astype(complex), steering.astype(complex), num_sources)
    found = method(covariance, steering, num_sources, products)
    # At its peaks MUSIC is the reciprocal of a hundred-thousandth, which float32 knows to 3 %.
    np.testing.assert_allclose(found, expected, rtol=0.05)
