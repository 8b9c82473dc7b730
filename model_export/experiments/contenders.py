"""Methods that an experiment compares."""

from __future__ import annotations

from dataclasses import replace

from model_export.baselines.catalogue import cards, classical, learned
from model_export.baselines.shipped import shipped
from model_export.experiments.study import Contender
from model_export.experiments.training import Training

NEURALMUSIC = Training("neuralmusic", pretrained=True)


def classical_contenders(*, linear: bool = False) -> list[Contender]:
    """Classical methods that fit a planar array, or a line."""
    methods = classical().items()
    return [Contender(name) for name, method in methods if linear or not method.card.linear_only]


def shipped_contenders(*, any_array: bool = False) -> list[Contender]:
    """The service's own bundles, trained as docs/training.md says and not for the comparison.

    ``any_array`` leaves out those that are bound to one array.
    """
    bundles = shipped().values()
    return [Contender(each.card.name) for each in bundles if not (any_array and each.bound)]


def cited_contenders() -> list[Contender]:
    """The networks as published."""
    return [Contender(f"{name}, cited", Training(name, "cited")) for name in learned()]


def matched_contenders(**variant: object) -> list[Contender]:
    """The networks with our input, targets and count branch, NeuralMUSIC last.

    ``variant`` are fields of their ``Training``.
    """
    trainings = [*(Training(name) for name in learned()), NEURALMUSIC]
    return [Contender(each.method, _replaced(each, variant)) for each in trainings]


def title(label: str) -> str:
    """A contender's name in tables."""
    name, _, rest = label.partition(", ")
    known = {**cards(), **{name: bundle.card for name, bundle in shipped().items()}}
    base = known[name].title if name in known else name
    return f"{base}, {rest}" if rest else base


def _replaced(training: Training, variant: dict[str, object]) -> Training:
    return replace(training, **variant)  # type: ignore[arg-type]
