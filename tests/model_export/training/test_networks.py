"""The paper's networks: sizes, Hermitian matrices, fusion and export by its text."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from model_export.training.networks.encoder import Encoder
from model_export.training.networks.fusion import FrequencyAttentionFusion
from model_export.training.networks.regressor import (
    DIAGONAL_LOADING,
    CovarianceNetwork,
    CovarianceRegressor,
)
from model_export.training.networks.source_count import SourceCountNetwork
from service.doa.fusion import attention_fusion, attention_weights

pytestmark = pytest.mark.torch


def parameters(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def seen(network: nn.Module, microphones: int = 4) -> nn.Module:
    """The network in evaluation, with batch statistics of one pass."""
    network.train()
    network(torch.randn(2, 2 * microphones, 257, 64))
    return network.eval()


@pytest.mark.parametrize(
    ("microphones", "encoder", "regressor"), [(4, 227715, 2080), (16, 241539, 33280)]
)
def test_sizes_are_those_of_the_paper(microphones: int, encoder: int, regressor: int) -> None:
    assert parameters(Encoder(microphones)) == encoder
    assert parameters(CovarianceRegressor(microphones)) == regressor


def test_the_count_branch_has_the_paper_s_size_and_a_class_for_every_count_from_0_to_4() -> None:
    network = SourceCountNetwork(4)
    assert parameters(network.blocks) == 10608
    assert parameters(network.classifier) == 262272 + 128 * 5 + 5
    assert seen(network)(torch.randn(3, 8, 257, 64)).shape == (3, 5)


def test_the_attention_has_a_sixteenth_of_the_bins_between_its_layers() -> None:
    assert parameters(FrequencyAttentionFusion()) == 8224


def test_an_encoder_gives_64_features_for_every_bin_and_its_weights_stand_alone() -> None:
    torch.manual_seed(0)
    network = CovarianceNetwork(4)
    pretrained = Encoder(4)
    network.encoder.load_state_dict(pretrained.state_dict())
    features = torch.randn(2, 8, 257, 64)
    latent = network.encoder.eval()(features)
    assert latent.shape == (2, 257, 64)
    torch.testing.assert_close(latent, pretrained.eval()(features))


def test_the_blocks_are_the_paper_s_convolution_norm_relu_pool() -> None:
    # Pooling stands before the ReLU to save time; the numbers must equal those of the text's order.
    torch.manual_seed(0)
    block = Encoder(1)[0].eval()
    features = torch.randn(2, 2, 19, 12)
    hidden = torch.relu(block[1](block[0](features)))
    torch.testing.assert_close(block(features), nn.functional.max_pool2d(hidden, 2))


def test_matrices_are_hermitian_and_loaded() -> None:
    torch.manual_seed(0)
    parts = CovarianceNetwork(4)(torch.randn(2, 8, 257, 64))
    assert parts.shape == (2, 257, 2, 4, 4)
    covariance = torch.complex(parts[:, :, 0], parts[:, :, 1])
    torch.testing.assert_close(covariance, covariance.mH, rtol=0, atol=0)
    regressor = CovarianceRegressor(3)
    nn.init.zeros_(regressor.linear.weight)
    nn.init.zeros_(regressor.linear.bias)
    nothing = regressor(torch.randn(1, 5, 64))
    torch.testing.assert_close(nothing[0, 0, 0], DIAGONAL_LOADING * torch.eye(3))
    assert not nothing[:, :, 1].any()


def test_the_regressor_reads_real_and_imaginary_columns_of_n_by_2n() -> None:
    regressor = CovarianceRegressor(2)
    nn.init.zeros_(regressor.linear.weight)
    with torch.no_grad():
        regressor.linear.bias.copy_(torch.tensor([1.0, 2.0, 0.0, 5.0, 4.0, 3.0, 1.0, 7.0]))
    real, imaginary = regressor(torch.zeros(1, 1, 64))[0, 0]
    raw = torch.tensor([[1.0, 2.0], [4.0, 3.0]]) + 1j * torch.tensor([[0.0, 5.0], [1.0, 7.0]])
    expected = 0.5 * (raw + raw.mH)
    torch.testing.assert_close(real, expected.real + DIAGONAL_LOADING * torch.eye(2))
    torch.testing.assert_close(imaginary, expected.imag)


@pytest.fixture
def fusion() -> FrequencyAttentionFusion:
    torch.manual_seed(0)
    fusion = FrequencyAttentionFusion()
    nn.init.normal_(fusion.excite.weight)  # far from the equal weights of a fresh layer
    return fusion


def test_fusion_is_a_convex_combination(fusion: FrequencyAttentionFusion) -> None:
    spectrum = torch.rand(3, 257, 90)
    alpha = fusion.attention(spectrum)
    assert ((alpha > 0) & (alpha < 1)).all()
    assert alpha.std() > 0.01
    fused = fusion(spectrum)
    assert (fused <= spectrum.amax(1)).all()
    assert (fused >= spectrum.amin(1)).all()
    same = torch.rand(3, 1, 90)
    torch.testing.assert_close(fusion(same.expand(-1, 257, -1)), same[:, 0])


def test_a_rotated_spectrum_fuses_to_a_rotated_one(fusion: FrequencyAttentionFusion) -> None:
    spectrum = torch.rand(2, 257, 90)
    torch.testing.assert_close(fusion(spectrum.roll(17, -1)), fusion(spectrum).roll(17, -1))


def test_the_service_fuses_as_training_does(fusion: FrequencyAttentionFusion) -> None:
    spectrum = torch.rand(2, 257, 90)
    weights = [layer.weight.detach().numpy() for layer in (fusion.squeeze, fusion.excite)]
    served = attention_fusion(spectrum.numpy(), attention_weights(spectrum.numpy(), *weights))
    np.testing.assert_allclose(served, fusion(spectrum).detach(), atol=1e-6)
