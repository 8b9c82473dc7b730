"""One published learned method in the comparison: as cited, and its trunk in the matched track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import nn

from model_export.baselines.matched import MatchedSpectrum, MatchedSubspace
from model_export.baselines.method import Card
from model_export.baselines.network import BaselineNetwork


class NetworkConstructor(Protocol):
    """A network with fresh parameters; width 1 is the cited size, of hidden layers."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> BaselineNetwork: ...


class TrunkConstructor(Protocol):
    """A trunk (``model_export.baselines.matched``) with fresh parameters."""

    def __call__(self, num_microphones: int, *, width: float = 1.0) -> nn.Module: ...


@dataclass(frozen=True, slots=True)
class LearnedBaseline:
    """Both tracks of a method and the widths at which a CPU trains them in the time there is."""

    card: Card
    cited: NetworkConstructor
    trunk: TrunkConstructor
    cited_width: float = 1.0
    trunk_width: float = 1.0

    def matched(self, num_microphones: int, *, width: float | None = None) -> BaselineNetwork:
        """The trunk in the matched track, at ``trunk_width`` where no width is given.

        Trunks that name ``bins`` estimate covariances, the others give an embedding.
        """
        trunk = self.trunk(num_microphones, width=self.trunk_width if width is None else width)
        network = MatchedSubspace if hasattr(trunk, "bins") else MatchedSpectrum
        return network(trunk, num_microphones, self.card)
