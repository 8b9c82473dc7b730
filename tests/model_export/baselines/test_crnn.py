"""CRNN: its input and its size."""

from __future__ import annotations

import pytest
from overfitting import windows

from model_export.baselines.crnn import Crnn

pytestmark = pytest.mark.torch


def test_its_input_is_mel_levels_and_correlations_of_64_values() -> None:
    features = Crnn(4, width=0.25).features(windows(4))
    assert features.shape == (2, 10, 64, 103)  # 103 frames of 20 ms every 10 ms
    levels, correlations = features[:, :4], features[:, 4:]
    assert levels.std() > 0.5
    assert abs(correlations).max() <= 1 + 1e-5


def test_it_has_the_size_that_its_repository_states() -> None:
    network = Crnn(4)
    ours = sum(parameter.numel() for parameter in network.trunk.parameters())
    assert ours + 129 == pytest.approx(1.295e6, rel=0.001)  # its one angle
    assert ours + 129 * 80 == pytest.approx(1.305e6, rel=0.001)  # 40 people's x and y
