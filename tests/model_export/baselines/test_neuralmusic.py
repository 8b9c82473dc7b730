"""NeuralMUSIC as a method of the comparison."""

from __future__ import annotations

import pytest
from overfitting import overfitted, untrained_parameters

from model_export.baselines.neuralmusic import neuralmusic
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch


def test_every_parameter_has_a_finite_gradient(scenes: list[SimulatedScene]) -> None:
    assert untrained_parameters(neuralmusic(4), scenes) == []


@pytest.mark.learns
def test_it_learns(scenes: list[SimulatedScene]) -> None:
    assert overfitted(neuralmusic(4), scenes, 40) < 3.0
