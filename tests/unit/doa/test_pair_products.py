"""Real products of pairs against a^H P a in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from service.doa.pair_products import pair_products
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray

FREQUENCIES = np.linspace(100.0, 7000.0, 9)


def steering_of(microphones: int) -> ComplexArray:
    rng = np.random.default_rng(microphones)
    positions = rng.uniform(-0.1, 0.1, (microphones, 3))
    return steering_vectors(positions, FREQUENCIES, azimuth_grid(72))


@pytest.mark.parametrize(("microphones", "dimension"), [(2, 1), (3, 2), (4, 1), (4, 3)])
def test_the_power_in_a_subspace_is_the_definitions(microphones: int, dimension: int) -> None:
    steering = steering_of(microphones)
    products = pair_products(steering)
    assert products is not None
    rng = np.random.default_rng(0)
    shape = (FREQUENCIES.size, microphones, dimension)
    subspace, _ = np.linalg.qr(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    adjoint = np.conj(np.swapaxes(subspace, -1, -2))
    expected = (np.abs(adjoint @ steering.astype(complex)) ** 2).sum(axis=-2) / microphones
    projector = (subspace @ adjoint).transpose(1, 2, 0)
    np.testing.assert_allclose(products.projector_power(projector, dimension), expected, atol=2e-6)


def test_many_microphones_and_whitened_steering_vectors_have_none() -> None:
    assert pair_products(steering_of(5)) is None
    assert pair_products(2 * steering_of(4)) is None
