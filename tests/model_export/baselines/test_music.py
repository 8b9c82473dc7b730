"""MUSIC behind covariance networks: counts by eigenvalues, angles from peaks."""

from __future__ import annotations

import pytest
import torch

from model_export.baselines.bands import planes
from model_export.baselines.music import EigenvalueCount, Music, PeakFinder
from service.doa.presets import preset

pytestmark = pytest.mark.torch


def covariances() -> torch.Tensor:
    root = torch.randn(6, 3, 4, 4, dtype=torch.complex64)
    return root @ root.mH


@torch.no_grad()
def test_the_count_depends_on_neither_scale_nor_basis() -> None:
    count, covariance = EigenvalueCount(4, 3).eval(), covariances()
    basis = torch.linalg.qr(torch.randn(4, 4, dtype=torch.complex64))[0]
    logits = count(covariance)
    torch.testing.assert_close(count(50 * covariance), logits, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(count(basis @ covariance @ basis.mH), logits, atol=1e-4, rtol=1e-4)
    assert (count(covariance + torch.eye(4)) - logits).abs().max() > 1e-3


def test_equal_eigenvalues_have_finite_gradients() -> None:
    music = Music(4, (20, 40, 60)).train()
    parts = planes(torch.eye(4, dtype=torch.complex64)).expand(2, 3, -1, -1, -1)
    parts = parts.clone().requires_grad_()
    result = music(parts, preset("respeaker-usb-4mic-v2"), torch.tensor([1, 2]))
    (result.spectrum.sum() + result.count.square().sum()).backward()
    assert parts.grad is not None
    assert parts.grad.isfinite().all()


@torch.no_grad()
def test_the_music_floor_is_learned_or_fixed() -> None:
    assert "log_floor" in dict(Music(4, (20,)).named_parameters())
    assert "log_floor" not in dict(Music(4, (20,), learned_floor=False).named_parameters())


@torch.no_grad()
def test_counts_default_to_the_classifier_s() -> None:
    music, array = Music(4, (20, 40, 60)).eval(), preset("respeaker-usb-4mic-v2")
    parts = planes(covariances())
    music.count.classifier[-1].bias[2] += 100
    told = music(parts, array, torch.full((6,), 2))
    torch.testing.assert_close(music(parts, array).projector, told.projector)
    ranks = told.projector.diagonal(dim1=-2, dim2=-1).real.sum(-1)
    torch.testing.assert_close(ranks, torch.full_like(ranks, 2.0))


@torch.no_grad()
def test_every_count_has_angles_of_its_own() -> None:
    first, second, third = PeakFinder(16)(torch.rand(5, 360))
    assert (first.shape, second.shape, third.shape) == ((5, 1), (5, 2), (5, 3))
    assert not torch.equal(first[:, 0], second[:, 0])
