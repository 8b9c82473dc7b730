"""Learned methods of the comparison whose networks output directions without a subspace method."""

from __future__ import annotations

from collections.abc import Mapping

from model_export.baselines import crnn, deepdae, doanet, transformer
from model_export.baselines.baseline import LearnedBaseline


def learned_methods() -> Mapping[str, LearnedBaseline]:
    """Both tracks of every method, by name."""
    methods = (
        LearnedBaseline(crnn.CARD, crnn.Crnn, crnn.CrnnTrunk),
        LearnedBaseline(
            transformer.CARD,
            transformer.Transformer,
            transformer.TransformerTrunk,
            cited_width=1 / 16,
            trunk_width=1 / 16,
        ),
        LearnedBaseline(doanet.CARD, doanet.Doanet, doanet.DoanetTrunk, cited_width=1 / 16),
        LearnedBaseline(deepdae.CARD, deepdae.DeepDae, deepdae.DeepDaeTrunk),
    )
    return {method.card.name: method for method in methods}
