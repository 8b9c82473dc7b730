"""Rank-one MUSIC spectra against the pseudo-spectrum's definition."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from service.doa.rank_one import RankOneMusic, shared_music
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray

FREQUENCIES = np.linspace(200.0, 6000.0, 12)
FLOOR = 0.004


def ring(microphones: int) -> FloatArray:
    angle = np.arange(microphones) * (2 * np.pi / microphones)
    return 0.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def unit_vectors(microphones: int, blocks: int) -> ComplexArray:
    rng = np.random.default_rng(microphones)
    shape = (blocks, FREQUENCIES.size, microphones)
    vectors = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    scaled: ComplexArray = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return scaled.astype(np.complex64)


def textbook(vectors: ComplexArray, steering: ComplexArray) -> FloatArray:
    """1 / (1 - |u^H a|^2 / N + floor) in double precision, every cell's maximum 1."""
    response = np.einsum("kfn,fna->fka", np.conj(vectors).astype(complex), steering.astype(complex))
    spectrum = 1 / (1 - np.abs(response) ** 2 / steering.shape[1] + FLOOR)
    normalised: FloatArray = spectrum / spectrum.max(axis=-1, keepdims=True)
    return normalised


@pytest.mark.parametrize("microphones", [2, 3, 4, 5, 8])
def test_spectra_are_the_definitions(microphones: int) -> None:
    steering = steering_vectors(ring(microphones), FREQUENCIES, azimuth_grid(90))
    vectors = unit_vectors(microphones, 3)
    spectra = RankOneMusic(steering, FLOOR).spectra(vectors)
    np.testing.assert_allclose(spectra, textbook(vectors, steering), atol=2e-4)


@pytest.mark.parametrize("azimuths", [azimuth_grid(91), azimuth_grid(90)[:44]])
def test_azimuths_need_not_come_in_opposite_pairs(azimuths: FloatArray) -> None:
    steering = steering_vectors(ring(4), FREQUENCIES, azimuths)
    vectors = unit_vectors(4, 3)
    spectra = RankOneMusic(steering, FLOOR).spectra(vectors)
    np.testing.assert_allclose(spectra, textbook(vectors, steering), atol=2e-4)


def test_whitened_steering_vectors_need_not_have_unit_entries() -> None:
    rng = np.random.default_rng(0)
    steering = steering_vectors(ring(4), FREQUENCIES, azimuth_grid(90))
    steering = (steering * rng.uniform(0.5, 1.5, (FREQUENCIES.size, 4, 1))).astype(np.complex64)
    steering *= 2 / np.linalg.norm(steering, axis=1, keepdims=True)
    vectors = unit_vectors(4, 3)
    spectra = RankOneMusic(steering, FLOOR).spectra(vectors)
    np.testing.assert_allclose(spectra, textbook(vectors, steering), atol=2e-4)


def test_robots_of_one_kind_share_one_and_other_arrays_do_not() -> None:
    first = shared_music(ring(4), FREQUENCIES, 90, FLOOR)
    assert shared_music(ring(4).copy(), FREQUENCIES, 90, FLOOR) is first
    others = [
        shared_music(ring(4) * 1.01, FREQUENCIES, 90, FLOOR),
        shared_music(ring(4), FREQUENCIES * 1.01, 90, FLOOR),
        shared_music(ring(4), FREQUENCIES, 180, FLOOR),
        shared_music(ring(4), FREQUENCIES, 90, 2 * FLOOR),
    ]
    assert len({id(each) for each in (first, *others)}) == 5


def test_nothing_is_kept_for_arrays_that_nobody_uses() -> None:
    from service.doa.rank_one import _shared

    positions = ring(4) * 0.77
    music = shared_music(positions, FREQUENCIES, 90, FLOOR)
    assert music in _shared.values()
    kept = len(_shared)
    del music
    gc.collect()
    assert len(_shared) == kept - 1
