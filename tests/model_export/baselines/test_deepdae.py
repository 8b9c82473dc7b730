"""CNN-GCCFB: its input, its target and its size."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import windows

from model_export.baselines.deepdae import LAGS, DeepDae, likelihood
from model_export.baselines.network import Truth

pytestmark = pytest.mark.torch


def test_its_input_is_51_lags_in_40_bands_of_6_pairs() -> None:
    assert DeepDae(4).features(windows(4)).shape == (2, 6, 40, 51)


def test_a_delay_of_one_sample_is_three_lags_of_its_own() -> None:
    audio = np.repeat(windows(1), 2, axis=1)
    audio[:, 0] = np.roll(audio[:, 0], 1, axis=-1)
    features = DeepDae(2).features(audio).mean(2)  # (2, 1, 51)
    assert LAGS[features.argmax(-1)].ravel() == pytest.approx(1.0)
    assert (features.argmax(-1) == 25 + 3).all()


def test_the_likelihood_is_composed_by_the_maximum_and_zero_without_a_source() -> None:
    azimuth = torch.deg2rad(torch.tensor([[10.0, 14.0, 0.0], [10.0, 14.0, 0.0]]))
    mask = torch.tensor([[True, True, False], [False, False, False]])
    coded = likelihood(Truth(azimuth, mask), 360)
    assert coded[0, [10, 14]].tolist() == pytest.approx([1.0, 1.0])
    assert coded[0, 12].item() == pytest.approx(np.exp(-((2 / 5) ** 2)), rel=1e-4)
    assert coded[0, 5].item() == pytest.approx(np.exp(-1.0), rel=1e-4)
    assert coded[1].abs().max() == 0


def test_it_has_the_size_of_the_publication() -> None:
    network = DeepDae(4)
    theirs = [*network.trunk.parameters(), *network.head.spectrum.parameters()]
    assert sum(parameter.numel() for parameter in theirs) == pytest.approx(0.57e6, rel=0.01)
