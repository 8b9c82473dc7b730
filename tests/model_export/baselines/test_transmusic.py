"""TransMUSIC: the transformer over snapshots, and that both tracks learn."""

from __future__ import annotations

import pytest
import torch
from overfitting import overfitted

from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.transmusic import SnapshotTransformer, TransMusic
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch


@torch.no_grad()
def test_the_covariance_does_not_depend_on_the_order_of_the_snapshots() -> None:
    network, snapshots = SnapshotTransformer(4, 10, 0.125).eval(), torch.randn(2, 4, 10, 64, 2)
    shuffled = snapshots[:, :, :, torch.randperm(64)]
    torch.testing.assert_close(network(shuffled), network(snapshots), atol=1e-4, rtol=1e-4)
    assert not torch.allclose(network(snapshots.flip(1)), network(snapshots), atol=1e-2)


@pytest.mark.learns
def test_it_learns_as_cited(scenes: list[SimulatedScene]) -> None:
    assert overfitted(TransMusic(4, width=0.25), scenes, 150) < 3.0


@pytest.mark.learns
def test_it_learns_in_the_matched_track(scenes: list[SimulatedScene]) -> None:
    assert overfitted(hybrid_methods()["transmusic"].matched(4, width=0.25), scenes, 140) < 3.0
