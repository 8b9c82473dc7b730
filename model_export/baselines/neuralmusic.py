"""NeuralMUSIC itself in the comparison: the paper's covariance network as a trunk."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.baselines.matched import MatchedSubspace
from model_export.baselines.method import Card
from model_export.training.networks import NUM_BINS
from model_export.training.networks.encoder import Encoder
from model_export.training.networks.regressor import CovarianceNetwork

CARD = Card(
    "neuralmusic",
    "NeuralMUSIC",
    "hybrid",
    "Yang, Fan, Yuan, Xie, NeuralMUSIC (arXiv 2606.18664)",
    "relative phases, a subspace term in the loss, a bounded MUSIC spectrum, FAF as in the text",
)


class CovarianceTrunk(nn.Module):
    """The paper's covariance network: maps (B, 2N, 257, 64) to (B, 257, 2, N, N)."""

    bins = range(NUM_BINS)

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.network = CovarianceNetwork(num_microphones)

    @property
    def encoder(self) -> Encoder:
        """The encoder, which self-supervised learning pretrains."""
        return self.network.encoder

    def forward(self, features: Tensor) -> Tensor:
        latent = self.network.encoder(features)
        with torch.autocast(features.device.type, enabled=False):
            covariance: Tensor = self.network.regressor(latent.float())
        return covariance


def neuralmusic(num_microphones: int, *, attention: bool = True) -> MatchedSubspace:
    """NeuralMUSIC with fresh parameters; without attention, bins count alike (ablation)."""
    trunk = CovarianceTrunk(num_microphones)
    return MatchedSubspace(trunk, num_microphones, CARD, attention=attention)
