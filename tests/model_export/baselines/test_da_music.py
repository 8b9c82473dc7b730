"""DA-MUSIC: the recurrence over snapshots, and that both tracks learn."""

from __future__ import annotations

import pytest
import torch
from overfitting import overfitted

from model_export.baselines.da_music import DaMusic, SnapshotGru
from model_export.baselines.hybrids import hybrid_methods
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch


@torch.no_grad()
def test_the_last_state_depends_on_the_order_of_the_snapshots() -> None:
    network, snapshots = SnapshotGru(4, 10, 1.0).eval(), torch.randn(2, 4, 10, 64, 2)
    assert not torch.allclose(network(snapshots), network(snapshots.flip(3)), atol=1e-3)


def test_at_the_cited_size_the_gru_has_two_units_per_microphone_and_band() -> None:
    assert DaMusic(4).covariance.recurrence.hidden_size == 2 * 4 * 10


@pytest.mark.learns
def test_it_learns_as_cited(scenes: list[SimulatedScene]) -> None:
    assert overfitted(DaMusic(4, width=0.5), scenes, 150) < 3.0


@pytest.mark.learns
def test_it_learns_in_the_matched_track(scenes: list[SimulatedScene]) -> None:
    assert overfitted(hybrid_methods()["da_music"].matched(4, width=0.5), scenes, 80) < 3.0
