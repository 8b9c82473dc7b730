"""Learned methods of the comparison whose networks name directions without a subspace method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from torch import nn

from model_export.baselines import crnn, deepdae, doanet, transformer
from model_export.baselines.matched import MatchedSpectrum
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork


class CitedConstructor(Protocol):
    """Builds the network as its publication has it, at a width of 1."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> BaselineNetwork: ...


class TrunkConstructor(Protocol):
    """Builds the module that stands in for it between the paper's features and a linear layer."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> nn.Module: ...


@dataclass(frozen=True, slots=True)
class LearnedBaseline:
    """One published method, as cited and in the matched track."""

    cited: CitedConstructor
    trunk: TrunkConstructor
    card: Card
    cited_width: float = 1.0
    """To train with on one CPU thread at 10 to 20 ms a sample"""
    trunk_width: float = 1.0

    def matched(self, num_microphones: int, *, width: float = 1.0) -> MatchedSpectrum:
        """The trunk with the matched track's features, spectrum and count branch."""
        return MatchedSpectrum(self.trunk(num_microphones, width=width), num_microphones, self.card)


def learned_methods() -> Mapping[str, LearnedBaseline]:
    """By name on the command line."""
    methods = (
        LearnedBaseline(crnn.Crnn, crnn.CrnnTrunk, crnn.CARD),
        LearnedBaseline(
            transformer.Transformer,
            transformer.TransformerTrunk,
            transformer.CARD,
            cited_width=1 / 16,
            trunk_width=1 / 16,
        ),
        LearnedBaseline(doanet.Doanet, doanet.DoanetTrunk, doanet.CARD, cited_width=1 / 16),
        LearnedBaseline(deepdae.DeepDae, deepdae.DeepDaeTrunk, deepdae.CARD),
    )
    return {method.card.name: method for method in methods}
