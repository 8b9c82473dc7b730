"""UNet-rootMUSIC: the U-Net's shapes, its loss on covariances, and that both tracks learn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from overfitting import batch_of, overfitted

from model_export.baselines.bands import ideal_covariance
from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.network import COUNT_WEIGHT, Truth, count_loss
from model_export.baselines.unet_rootmusic import CovarianceUNet, UNetRootMusic
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("microphones", [2, 3, 5, 8])
@torch.no_grad()
def test_any_number_of_microphones(microphones: int) -> None:
    covariance = torch.randn(2, 5, 2, microphones, microphones)
    assert CovarianceUNet(5, 0.125)(covariance).shape == covariance.shape


@torch.no_grad()
def test_the_loss_vanishes_at_the_ideal_covariances_however_the_array_is_turned(
    scenes: list[SimulatedScene],
) -> None:
    network, array = UNetRootMusic(4, width=0.125), scenes[0].array
    features, truth = batch_of(network, scenes)
    prediction = network(features, array, truth.count)
    ideal = ideal_covariance(array, truth, network.music.frequencies)
    prediction = replace(prediction, covariance=ideal)
    count = COUNT_WEIGHT * count_loss(prediction, truth)
    turned = Truth(truth.azimuth + 1.0, truth.mask)
    for directions, axis in ((truth, array), (turned, array.rotated(1.0))):
        loss = network.loss(prediction, directions, axis)
        np.testing.assert_allclose(loss, count, atol=1e-6)
    assert network.loss(prediction, turned, array) > count + 0.01


@pytest.mark.learns
def test_it_learns_as_cited(scenes: list[SimulatedScene]) -> None:
    assert overfitted(UNetRootMusic(4, width=0.5), scenes, 120) < 3.0


@pytest.mark.learns
def test_it_learns_in_the_matched_track(scenes: list[SimulatedScene]) -> None:
    assert overfitted(hybrid_methods()["unet_rootmusic"].matched(4, width=0.5), scenes, 80) < 3.0
