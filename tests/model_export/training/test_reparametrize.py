"""The network as it is trained against the text's: one function, and nothing else leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from model_export.training.config import PAPER, PAPER_SSCL, TrainingConfig
from model_export.training.networks.encoder import Encoder
from model_export.training.networks.regressor import CovarianceNetwork
from model_export.training.regression import RegressionTask
from model_export.training.reparametrize import load_plain, merge, reparametrize
from model_export.training.sscl import SsclTask

pytestmark = pytest.mark.torch

PLAIN = replace(PAPER, smooth_kernels=0, pool_first=False)


def trained(config: TrainingConfig) -> CovarianceNetwork:
    """A network with statistics, scales of both signs where they can have them, and offsets."""
    torch.manual_seed(0)
    network = CovarianceNetwork(4)
    reparametrize(network, config)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.5 * parameter.std() * torch.randn_like(parameter)
        for block in list(network.encoder)[:4]:
            block[1].running_mean += 0.1 * torch.randn_like(block[1].running_mean)
            if config.pool_first:
                original = block[1].parametrizations.weight.original
                original *= torch.randn_like(original).sign()
    return network.eval()


@torch.no_grad()
@pytest.mark.parametrize(
    "config",
    [replace(PLAIN, pool_first=True), replace(PLAIN, smooth_kernels=12), PAPER],
    ids=["pooled first", "smooth", "both"],
)
def test_the_merged_network_is_the_text_s_and_computes_the_same(config: TrainingConfig) -> None:
    network = trained(config)
    features = torch.randn(2, 8, 257, 64)
    expected = network(features)
    merge(network)
    plain = CovarianceNetwork(4).eval()
    plain.load_state_dict(network.state_dict())  # names and shapes are those of the text
    torch.testing.assert_close(plain(features), expected, rtol=1e-4, atol=1e-5)
    assert not np.allclose(expected, 0)


@torch.no_grad()
def test_a_smooth_convolution_has_few_frequencies_over_its_channels_and_the_usual_size() -> None:
    torch.manual_seed(0)
    encoder = Encoder(4)
    usual = encoder[3][0].weight.std()
    reparametrize(encoder, PAPER)
    kernels = encoder[3][0].weight
    assert kernels.std().item() == pytest.approx(usual.item(), rel=0.05)
    mirrored = torch.cat([kernels, kernels.flip(0)])  # a cosine transform by a Fourier transform
    spectrum = torch.fft.rfft(mirrored, dim=0).abs()
    assert spectrum[PAPER.smooth_kernels :].max() < 1e-4 * spectrum.max()


@torch.no_grad()
def test_merged_parameters_come_back_into_the_trained_network() -> None:
    network = trained(PAPER)
    features = torch.randn(1, 8, 257, 64)
    expected = network(features)
    merge(network)
    other = CovarianceNetwork(4)
    reparametrize(other, PAPER)
    load_plain(other, network.state_dict())
    torch.testing.assert_close(other.eval()(features), expected, rtol=1e-4, atol=1e-5)
    with pytest.raises(RuntimeError, match="size mismatch"):
        load_plain(CovarianceNetwork(6), network.state_dict())


def test_negative_scales_cannot_be_trained_with_pooling_first() -> None:
    network = trained(PLAIN)
    with torch.no_grad():
        network.encoder[0][1].weight[3] = -1
    other = CovarianceNetwork(4)
    reparametrize(other, PAPER)
    with pytest.raises(ValueError, match="pool_first"):
        load_plain(other, network.state_dict())


@torch.no_grad()
def test_a_merged_first_stage_starts_a_second_that_is_trained_otherwise() -> None:
    start, task = SsclTask(PAPER_SSCL), RegressionTask(PAPER)
    features = torch.randn(1, 8, 257, 64)
    expected = start.model.eval().encoder(features)
    merge(start.model)
    task.start_from(start)
    found = task.model.eval().covariance.encoder(features)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
