"""The differentiable projector against finite differences, autograd and the service's numpy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from model_export.training.subspace import (
    delay_products,
    dominance,
    hermitian_rows,
    signal_power,
    signal_projector,
)
from service.doa import evd, music
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, steering_vectors, unit_vectors

pytestmark = pytest.mark.torch

FREQUENCIES = np.array([0.0, 500.0, 2000.0, 7000.0])
ARRAY = preset("respeaker-usb-4mic-v2")


def random_unitary(size: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    unitary: Tensor = torch.linalg.qr(
        torch.randn(size, size, dtype=torch.complex128, generator=generator)
    ).Q
    return unitary


def hermitian_with(eigenvalues: list[float], seed: int = 0) -> Tensor:
    """A Hermitian matrix, or a stack of one, with exactly these eigenvalues."""
    unitary = random_unitary(len(eigenvalues), seed)
    values = torch.tensor(eigenvalues, dtype=torch.complex128)
    return unitary @ torch.diag(values) @ unitary.mH


def hermitian_part(matrix: Tensor) -> Tensor:
    return 0.5 * (matrix + matrix.mH)


@pytest.mark.parametrize("num_sources", [1, 2, 3])
def test_the_gradient_is_that_of_finite_differences(num_sources: int) -> None:
    covariance = torch.stack([hermitian_with([0.3, 0.9, 1.7, 4.0], seed) for seed in range(2)])
    covariance.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda matrix: signal_projector(hermitian_part(matrix), num_sources), covariance
    )


@pytest.mark.parametrize(
    ("eigenvalues", "num_sources"),
    [([1.0, 1.0, 1.0, 5.0], 1), ([0.5, 0.5, 3.0, 3.0], 2), ([1e-5, 1e-5, 1e-5, 2.0], 1)],
)
def test_the_gradient_is_right_where_eigenvalues_coincide_inside_a_subspace(
    eigenvalues: list[float], num_sources: int
) -> None:
    # Noise eigenvalues coincide in every noiseless and every diagonally loaded covariance.
    covariance = torch.diag(torch.tensor(eigenvalues, dtype=torch.complex128))
    weights = hermitian_with([-1.0, 0.2, 0.7, 2.0], seed=3)

    def loss(matrix: Tensor) -> Tensor:
        projector = signal_projector(hermitian_part(matrix), num_sources)
        return (projector * weights.conj()).sum().real

    covariance.requires_grad_()
    loss(covariance).backward()
    gradient = covariance.grad
    assert gradient is not None
    step = 1e-6 * min(gap for gap in np.diff(eigenvalues) if gap > 0)
    for seed in range(4):
        direction = hermitian_part(random_unitary(4, seed))
        with torch.no_grad():
            forward = loss(covariance + step * direction)
            backward = loss(covariance - step * direction)
        slope = (gradient.conj() * direction).sum().real
        assert slope == pytest.approx((forward - backward).item() / (2 * step), rel=1e-4, abs=1e-6)


def test_autograd_through_eigenvectors_fails_where_the_projector_does_not() -> None:
    weights = hermitian_with([-1.0, 0.2, 0.7, 2.0], seed=3)

    def gradient_of(through_projector: bool) -> Tensor:
        covariance = torch.diag(torch.tensor([1.0, 1.0, 1.0, 5.0], dtype=torch.complex128))
        covariance.requires_grad_()
        if through_projector:
            projector = signal_projector(covariance, 1)
        else:
            signal = torch.linalg.eigh(covariance).eigenvectors[:, -1:]
            projector = signal @ signal.mH
        (projector * weights.conj()).sum().real.backward()
        assert covariance.grad is not None
        return covariance.grad

    assert torch.isfinite(torch.view_as_real(gradient_of(through_projector=True))).all()
    assert not torch.isfinite(torch.view_as_real(gradient_of(through_projector=False))).all()


def test_the_gradient_agrees_with_autograd_where_eigenvalues_are_apart() -> None:
    weights = hermitian_with([-1.0, 0.2, 0.7, 2.0], seed=3)
    gradients = []
    for through_projector in (True, False):
        covariance = hermitian_with([0.3, 0.9, 1.7, 4.0]).requires_grad_()
        if through_projector:
            projector = signal_projector(covariance, 2)
        else:
            signal = torch.linalg.eigh(covariance).eigenvectors[:, -2:]
            projector = signal @ signal.mH
        (projector * weights.conj()).sum().real.backward()
        assert covariance.grad is not None
        gradients.append(hermitian_part(covariance.grad))
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-12)


def test_a_vanishing_gap_between_signal_and_noise_keeps_the_gradient_finite() -> None:
    covariance = torch.eye(4, dtype=torch.complex64).requires_grad_()
    signal_projector(covariance, 2)[0, 1].real.backward()
    assert covariance.grad is not None
    assert torch.isfinite(torch.view_as_real(covariance.grad)).all()


def test_the_projector_is_one() -> None:
    projector = signal_projector(hermitian_with([0.3, 0.9, 1.7, 4.0]), 3)
    torch.testing.assert_close(projector @ projector, projector)
    torch.testing.assert_close(projector, projector.mH)
    assert projector.diagonal().real.sum().item() == pytest.approx(3)


def products_of(array: MicrophoneArray) -> Tensor:
    """Products (F, N^2, 72) of the array's steering vectors."""
    centred = array.positions - array.positions.mean(axis=0)
    delays = torch.from_numpy(centred @ unit_vectors(azimuth_grid(72)).T / 343.0)
    return delay_products(delays[None].float(), torch.from_numpy(FREQUENCIES).float())[0]


@pytest.mark.parametrize("num_sources", [1, 2, 3])
def test_training_and_service_compute_the_same_spectra(num_sources: int) -> None:
    rng = np.random.default_rng(num_sources)
    shape = (len(FREQUENCIES), 4, 4)
    root = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    covariance = (root @ root.conj().swapaxes(-1, -2)).astype(np.complex64)
    steering = steering_vectors(ARRAY.positions, FREQUENCIES, azimuth_grid(72))
    subspace = evd.signal_subspace(covariance, num_sources)
    expected = music.music_spectrum(subspace, steering, floor=0.04)
    projector = signal_projector(torch.from_numpy(covariance), num_sources)
    power = signal_power(projector[:, None], products_of(ARRAY))[:, 0]
    spectrum = 1 / (1 - power.clamp(max=1) + 0.04)
    np.testing.assert_allclose(power, music.signal_power(subspace, steering), atol=1e-5)
    np.testing.assert_allclose(spectrum, expected, rtol=1e-3)


def test_products_of_delays_are_quadratic_forms_of_the_steering_vectors() -> None:
    matrix = hermitian_with([-1.0, 0.2, 0.7, 2.0])
    steering = steering_vectors(ARRAY.positions, FREQUENCIES, azimuth_grid(72))
    direct = np.einsum("fna,nm,fma->fa", steering.conj(), matrix.numpy(), steering).real
    forms = hermitian_rows(matrix).float() @ products_of(ARRAY)
    np.testing.assert_allclose(forms, direct, rtol=1e-4, atol=1e-4)


def test_dominance_is_one_for_a_plane_wave_and_zero_in_an_isotropic_field() -> None:
    wave = hermitian_with([0.0, 0.0, 0.0, 3.0])
    field = 2 * torch.eye(4, dtype=torch.complex128)
    for covariance, expected in ((wave, 1.0), (field, 0.0)):
        value = dominance(covariance, signal_projector(covariance, 1))
        assert value.item() == pytest.approx(expected, abs=1e-9)
