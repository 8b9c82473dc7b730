"""The covariance and subspace methods of the comparison, by their names."""

from __future__ import annotations

from collections.abc import Mapping

from model_export.baselines import da_music, deepmusic, subspacenet, transmusic, unet_rootmusic
from model_export.baselines.baseline import LearnedBaseline


def hybrid_methods() -> Mapping[str, LearnedBaseline]:
    """Both tracks of every method whose features or outputs are covariances."""
    baselines = (
        LearnedBaseline(
            deepmusic.CARD,
            deepmusic.DeepMusic,
            deepmusic.DeepMusicTrunk,
            cited_width=0.125,
            trunk_width=0.25,
        ),
        LearnedBaseline(da_music.CARD, da_music.DaMusic, da_music.DaMusicTrunk),
        LearnedBaseline(subspacenet.CARD, subspacenet.SubspaceNet, subspacenet.SubspaceNetTrunk),
        LearnedBaseline(
            unet_rootmusic.CARD, unet_rootmusic.UNetRootMusic, unet_rootmusic.UNetRootMusicTrunk
        ),
        LearnedBaseline(
            transmusic.CARD,
            transmusic.TransMusic,
            transmusic.TransMusicTrunk,
            cited_width=0.5,
            trunk_width=0.5,
        ),
    )
    return {baseline.card.name: baseline for baseline in baselines}
