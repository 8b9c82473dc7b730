"""SubspaceNet: its layers, its loss on a spectrum, and that both tracks learn."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import overfitted
from torch import Tensor

from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.network import Truth
from model_export.baselines.subspacenet import (
    LAGS,
    AntiRectifier,
    AutocorrelationNetwork,
    SubspaceNet,
    expected_square,
)
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch


def test_the_anti_rectifier_loses_nothing() -> None:
    inputs = torch.randn(2, 3, 4, 4)
    positive, negative = AntiRectifier()(inputs).chunk(2, 1)
    torch.testing.assert_close(positive - negative, inputs)
    assert positive.min() >= 0
    assert negative.min() >= 0


@pytest.mark.parametrize("microphones", [2, 3, 4, 7])
@torch.no_grad()
def test_any_number_of_microphones(microphones: int) -> None:
    autocorrelation = torch.randn(2, 5, LAGS, 2, microphones, microphones)
    covariance = AutocorrelationNetwork(microphones, 0.25)(autocorrelation)
    assert covariance.shape == (2, 5, 2, microphones, microphones)


def peaks(*azimuth_deg: int) -> Tensor:
    spectrum = torch.zeros(1, 360)
    spectrum[0, list(azimuth_deg)] = 1.0
    return spectrum


def truth(*azimuth_deg: float) -> Truth:
    azimuth = torch.zeros(1, 3)
    azimuth[0, : len(azimuth_deg)] = torch.deg2rad(torch.tensor(azimuth_deg))
    return Truth(azimuth, torch.arange(3)[None] < len(azimuth_deg))


def error_deg(spectrum: Tensor, sources: Truth) -> float:
    return float(torch.rad2deg(expected_square(50 * spectrum, sources).sqrt()))


def test_the_expected_error_is_that_of_the_peaks() -> None:
    assert error_deg(peaks(70), truth(70.0)) == pytest.approx(0, abs=0.1)
    assert error_deg(peaks(75), truth(70.0)) == pytest.approx(5, abs=0.1)
    assert error_deg(peaks(2), truth(358.0)) == pytest.approx(4, abs=0.1)
    both = np.sqrt((3**2 + 4**2) / 2)
    assert error_deg(peaks(73, 196), truth(200.0, 70.0)) == pytest.approx(both, abs=0.1)


def test_flat_spectra_false_peaks_and_missed_sources_cost() -> None:
    assert error_deg(torch.zeros(1, 360), truth(70.0)) == pytest.approx(180 / np.sqrt(3), abs=0.1)
    assert error_deg(peaks(70, 250), truth(70.0)) == pytest.approx(180 / np.sqrt(2), abs=0.1)
    assert error_deg(peaks(70), truth(70.0, 200.0)) > 20


def test_scenes_without_sources_cost_nothing_and_have_finite_gradients() -> None:
    spectrum = peaks(70).requires_grad_()
    error = expected_square(spectrum, truth())
    error.backward()
    assert error.item() == 0
    assert spectrum.grad is not None
    assert spectrum.grad.abs().max() == 0


@pytest.mark.learns
def test_it_learns_as_cited(scenes: list[SimulatedScene]) -> None:
    assert overfitted(SubspaceNet(4), scenes, 200) < 3.0


@pytest.mark.learns
def test_it_learns_in_the_matched_track(scenes: list[SimulatedScene]) -> None:
    assert overfitted(hybrid_methods()["subspacenet"].matched(4, width=0.5), scenes, 160) < 3.0
