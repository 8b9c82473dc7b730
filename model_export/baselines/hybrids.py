"""The covariance and subspace methods of the comparison, by name."""

from __future__ import annotations

from collections.abc import Mapping

from model_export.baselines import da_music, deepmusic, subspacenet, transmusic, unet_rootmusic
from model_export.baselines.baseline import LearnedBaseline


def hybrid_methods() -> Mapping[str, LearnedBaseline]:
    """Both tracks, by name, of every method whose features or outputs are covariances."""
    baselines = (
        LearnedBaseline(
            card=deepmusic.CARD,
            cited=deepmusic.DeepMusic,
            trunk=deepmusic.DeepMusicTrunk,
            cited_width=0.5,
        ),
        LearnedBaseline(card=da_music.CARD, cited=da_music.DaMusic, trunk=da_music.DaMusicTrunk),
        LearnedBaseline(
            card=subspacenet.CARD,
            cited=subspacenet.SubspaceNet,
            trunk=subspacenet.SubspaceNetTrunk,
        ),
        LearnedBaseline(
            card=unet_rootmusic.CARD,
            cited=unet_rootmusic.UNetRootMusic,
            trunk=unet_rootmusic.UNetRootMusicTrunk,
        ),
        LearnedBaseline(
            card=transmusic.CARD,
            cited=transmusic.TransMusic,
            trunk=transmusic.TransMusicTrunk,
        ),
    )
    return {baseline.card.name: baseline for baseline in baselines}
