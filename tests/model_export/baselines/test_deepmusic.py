"""DeepMUSIC: its images, sub-regions and target, and that both tracks learn."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import batch_of, overfitted

from model_export.baselines.deepmusic import (
    REGIONS,
    DeepMusic,
    covariance_images,
    ideal_spectrum,
)
from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.network import Truth
from model_export.simulation.protocol import SimulatedScene
from service.doa.peaks import find_peaks
from service.doa.presets import preset

pytestmark = pytest.mark.torch


def test_images_are_real_part_imaginary_part_and_angle_of_every_band() -> None:
    snapshots = torch.tensor([[[[1.0 + 0j]], [[2j]]]])  # one frame of two microphones in one band
    images = covariance_images(snapshots)
    # x0 conj(x1) = -2j
    np.testing.assert_allclose(images[0, :, 0, 1], [0, -2, -0.5], atol=1e-6)
    np.testing.assert_allclose(images[0, :, 1, 1], [4, 0, 0], atol=1e-6)


@torch.no_grad()
def test_a_sub_region_s_network_speaks_of_its_part_alone(scenes: list[SimulatedScene]) -> None:
    network = DeepMusic(4, width=0.06).eval()
    features, _ = batch_of(network, scenes[:2])
    before = network(features, scenes[0].array).spectrum
    network.regions[3][0].weight.zero_()
    changed = (network(features, scenes[0].array).spectrum != before).any(0)
    size = 360 // REGIONS
    assert changed[3 * size : 4 * size].any()
    assert not changed[: 3 * size].any()
    assert not changed[4 * size :].any()


def test_the_target_peaks_at_the_sources_and_is_zero_without_any() -> None:
    azimuth = torch.deg2rad(torch.tensor([[70.0, 200.0, 0.0], [5.0, 0.0, 0.0]]))
    truth = Truth(azimuth, torch.tensor([[True, True, False], [False, False, False]]))
    network = DeepMusic(4, width=0.06)
    spectrum = ideal_spectrum(preset("respeaker-usb-4mic-v2"), truth, network.frequencies)
    found = sorted(np.rad2deg(p.azimuth) for p in find_peaks(spectrum[0].numpy(), 2))
    np.testing.assert_allclose(found, [70, 200], atol=0.5)
    assert spectrum[0].max() == 1
    assert spectrum[1].abs().max() == 0


@pytest.mark.learns
def test_it_learns_as_cited(scenes: list[SimulatedScene]) -> None:
    assert overfitted(DeepMusic(4, width=0.125), scenes, 80) < 3.0


@pytest.mark.learns
def test_it_learns_in_the_matched_track(scenes: list[SimulatedScene]) -> None:
    assert overfitted(hybrid_methods()["deepmusic"].matched(4, width=0.25), scenes, 80) < 3.0
