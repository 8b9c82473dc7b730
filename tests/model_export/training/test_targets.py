"""Target spectra on the circle and the losses against them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from model_export.training.targets import spectrum_cross_entropy, target_spectrum, wrapped_gaussians

pytestmark = pytest.mark.torch

GRID = torch.deg2rad(torch.arange(360.0))
SIGMA = float(np.deg2rad(5.0))


def target_of(*azimuths_deg: float) -> Tensor:
    """Target (360,) of sources at these azimuths; the padding between them must not count."""
    azimuth = torch.zeros(1, 4)
    azimuth[0, : len(azimuths_deg)] = torch.deg2rad(torch.tensor(azimuths_deg))
    return target_spectrum(azimuth, torch.arange(4)[None] < len(azimuths_deg), GRID, SIGMA)[0]


def test_a_source_at_the_wrap_is_as_wide_on_both_sides() -> None:
    target = target_of(0.0)
    assert target.argmax() == 0
    torch.testing.assert_close(target[1:180], target[181:].flip(0), rtol=0, atol=1e-5)
    torch.testing.assert_close(target_of(359.0), target_of(1.0).roll(-2), rtol=0, atol=1e-5)


def test_the_width_is_sigma() -> None:
    assert target_of(100.0)[105].item() == pytest.approx(np.exp(-0.5), rel=1e-4)
    assert target_of(358.0)[3].item() == pytest.approx(np.exp(-0.5), rel=1e-4)


@pytest.mark.parametrize("azimuths", [(40.0,), (40.0, 200.0), (359.0, 100.0), (10.0, 14.0, 300.0)])
def test_the_maximum_is_one(azimuths: tuple[float, ...]) -> None:
    assert target_of(*azimuths).max().item() == pytest.approx(1.0)


def test_two_distant_sources_have_a_peak_each_in_either_order() -> None:
    target = target_of(2.0, 100.0)
    assert target[2].item() == pytest.approx(1.0)
    assert target[100].item() == pytest.approx(1.0)
    assert target[359].item() == pytest.approx(np.exp(-0.5 * (3 / 5) ** 2), rel=1e-4)
    torch.testing.assert_close(target, target_of(100.0, 2.0))


def test_without_a_source_the_target_is_zero() -> None:
    assert not target_of().any()


def test_a_gaussian_keeps_its_height_between_grid_angles() -> None:
    bumps = wrapped_gaussians(torch.deg2rad(torch.tensor([33.4])), GRID, SIGMA)
    assert bumps.shape == (1, 360)
    assert bumps[0, 33].item() == pytest.approx(np.exp(-0.5 * (0.4 / 5) ** 2), rel=1e-4)


def test_cross_entropy_is_least_where_the_softmax_is_the_target() -> None:
    target = target_of(50.0, 200.0)[None] + 1e-3
    truth = target.log()  # softmax of it is the target scaled to sum to one
    truth.requires_grad_()
    least = spectrum_cross_entropy(truth, target, torch.tensor(1.0))
    least.backward()
    assert truth.grad is not None
    assert truth.grad.abs().max() < 1e-7
    for shift in (-30, 3, 90):
        worse = spectrum_cross_entropy(truth.detach().roll(shift, -1), target, torch.tensor(1.0))
        assert worse > least


def test_scenes_without_a_source_cost_nothing() -> None:
    fused = torch.rand(2, 360, requires_grad=True)
    target = torch.stack([target_of(), target_of(50.0)])
    sharpness = torch.tensor(10.0)
    both = spectrum_cross_entropy(fused, target, sharpness)
    torch.testing.assert_close(both, spectrum_cross_entropy(fused[1:], target[1:], sharpness))
    assert spectrum_cross_entropy(fused[:1], target[:1], sharpness).item() == 0
