"""The weights network over a stream: past frames are kept as state and not computed again.

Every convolution of the trunk looks one frame ahead. Behind k of them the newest k frames are
therefore provisional: zeros stood for their future, as for a window's last frames. Every block
keeps the final frames that it reaches back to, and computes the provisional ones again, finally, in
the next step. Each step outputs weights and attentions of the new frames and of the last step's
provisional ones.
"""

from __future__ import annotations

from collections import deque

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.export.bundle import ExportGraph
from model_export.training.weights import (
    Ahead,
    BandContext,
    PastContext,
    Separable,
    WeightsNetwork,
)
from service.doa.features import NUM_FEATURES

STEP_FRAMES = 6


class StreamingWeightsNetwork(nn.Module):
    """One step of a ``WeightsNetwork``, whose parameters it shares."""

    def __init__(self, network: WeightsNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, features: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Weights and attentions (B, lookahead + L, F) of the newest frames, then the new states.

        Parameters
        ----------
        features : (B, 5, L, F)
        state : sequence of Tensor
            States in the order of ``initial_state``: past frames that each convolution needs again.
        """
        queue = deque(state)
        following: list[Tensor] = []

        def behind(hidden: Tensor, provisional: int) -> Tensor:
            """Join kept and new frames; keep as many final frames for the next step."""
            kept = queue.popleft()
            joined = torch.cat([kept, hidden], 2)
            end = joined.shape[2] - provisional
            following.append(joined[:, :, end - kept.shape[2] : end])
            return joined

        hidden = self.network.image(features)
        ahead = 0
        for block in self.network.blocks:
            if isinstance(block, BandContext):
                band = block.convolve(behind(block.mean(hidden), ahead))
                hidden = block.step(behind(band, ahead), hidden)
                continue
            assert isinstance(block, Ahead | PastContext | Separable)
            joined = behind(hidden, ahead)
            if block.looks_ahead:
                joined = F.pad(joined, (0, 0, 0, 1))
                hidden = joined[:, :, 1:-1]
                ahead += 1
            hidden = block.step(joined, hidden)
        weights, attention = self.network.cells(hidden)
        return (weights, attention, *following)

    def initial_state(self, batch: int, bins: int) -> dict[str, Tensor]:
        """States at the start of a stream, zeros, by name."""
        state = {}
        width = bins
        for index, block in enumerate(self.network.blocks):
            if isinstance(block, BandContext):
                shape = (batch, block.first.in_channels, block.reach, 1)
                state[f"band_first_{index}"] = torch.zeros(shape)
                state[f"band_second_{index}"] = torch.zeros(shape)
                continue
            assert isinstance(block, Ahead | PastContext | Separable)
            shape = (batch, block.inputs, block.reach, width)
            state[f"{'ahead' if block.looks_ahead else 'past'}_{index}"] = torch.zeros(shape)
            width //= block.stride
        return state


def stream_graph(network: WeightsNetwork, bins: int) -> ExportGraph:
    """Graph from features and state to weights, attentions and the next state."""
    streaming = StreamingWeightsNetwork(network)
    features = torch.zeros(2, NUM_FEATURES, STEP_FRAMES, bins)
    state = streaming.initial_state(2, bins)
    return ExportGraph(
        streaming,
        (features, *state.values()),
        ("features", *state),
        ("weights", "attention", *(f"next_{name}" for name in state)),
        ({0: "batch", 2: "frames"}, *({0: "batch"} for _ in state)),
    )
