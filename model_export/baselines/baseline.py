"""One published learned method in the comparison: as cited, and its trunk in the matched track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import nn

from model_export.baselines.matched import MatchedSpectrum, MatchedSubspace
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork


class NetworkConstructor(Protocol):
    """Constructor of a network with fresh parameters; width 1 has the cited hidden sizes."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> BaselineNetwork: ...


class TrunkConstructor(Protocol):
    """Constructor of a trunk (``model_export.baselines.matched``) with fresh parameters."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> nn.Module: ...


@dataclass(frozen=True, slots=True)
class LearnedBaseline:
    """Both tracks of a method, and the widths at which a CPU can train them."""

    card: Card
    cited: NetworkConstructor
    trunk: TrunkConstructor
    cited_width: float = 1.0
    trunk_width: float = 1.0

    def matched(self, num_microphones: int, *, width: float | None = None) -> BaselineNetwork:
        """The trunk in the matched track, by default at ``trunk_width``.

        Trunks with an attribute ``bins`` estimate covariances, the others return an embedding.
        """
        trunk = self.trunk(num_microphones, width=self.trunk_width if width is None else width)
        network = MatchedSubspace if hasattr(trunk, "bins") else MatchedSpectrum
        return network(trunk, num_microphones, self.card)
