"""All methods by name: cards, classical methods ready to use, networks with fresh parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

from model_export.baselines.baseline import LearnedBaseline
from model_export.baselines.classical import classical_methods
from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.learned import learned_methods
from model_export.baselines.method import Card, Method
from model_export.baselines.network import BaselineNetwork
from model_export.baselines.neuralmusic import CARD as NEURALMUSIC
from model_export.baselines.neuralmusic import neuralmusic

ORDER = (
    "music", "norm_music", "srp_phat", "gcc_phat", "tops", "cssm", "waves", "frida", "root_music",
    "crnn", "transformer", "doanet", "deepdae", "deepmusic", "da_music", "subspacenet",
    "unet_rootmusic", "transmusic", "neuralmusic",
)  # fmt: skip
MICROPHONES = 4
"""Number of microphones for which parameters are counted"""


@cache
def classical() -> Mapping[str, Method]:
    """Classical methods by name."""
    return {method.card.name: method for method in classical_methods()}


@cache
def learned() -> Mapping[str, LearnedBaseline]:
    """Networks by name that NeuralMUSIC is compared with."""
    return {**learned_methods(), **hybrid_methods()}


def cards() -> dict[str, Card]:
    """Every method's card, in the tables' order."""
    found = {
        **{name: method.card for name, method in classical().items()},
        **{name: baseline.card for name, baseline in learned().items()},
        NEURALMUSIC.name: NEURALMUSIC,
    }
    return {name: found[name] for name in ORDER}


def network(
    name: str,
    track: Literal["cited", "matched"],
    num_microphones: int = MICROPHONES,
    *,
    reduced: bool = False,
    attention: bool = True,
) -> BaselineNetwork:
    """A network with fresh parameters.

    Parameters
    ----------
    track : str
        NeuralMUSIC has one track only, its own: the matched one.
    reduced : bool
        Takes the width that a CPU can train in minutes, if the cited one is too heavy.
    attention : bool
        False leaves NeuralMUSIC's frequencies unweighted.

    Raises
    ------
    ValueError
        If there is no network of this name.
    """
    if name == NEURALMUSIC.name:
        return neuralmusic(num_microphones, attention=attention)
    if name not in learned():
        raise ValueError(f"no network is named {name!r}: {', '.join([*learned(), 'neuralmusic'])}")
    baseline = learned()[name]
    if track == "cited":
        return baseline.cited(num_microphones, width=baseline.cited_width if reduced else 1.0)
    return baseline.matched(num_microphones, width=None if reduced else 1.0)


def described() -> list[dict[str, Any]]:
    """Entries of ``methods --json``; parameters are those of the cited networks."""
    return [
        {
            "name": name,
            "title": card.title,
            "kind": card.kind,
            "parameters": 0 if name in classical() else _size(network(name, "cited")),
            "source": card.source,
            "adaptation": card.adaptation,
        }
        for name, card in cards().items()
    ]


def _size(module: BaselineNetwork) -> int:
    return sum(parameter.numel() for parameter in module.parameters())
