"""The weights network over a stream: each frame's convolutions once, what they need later as state.

The network is causal but for its first four convolutions, which look one frame ahead each. So a
step takes the new frames with the eight before them, gives weights and attentions of the new frames
and of the four before, and keeps what the dilated convolutions reach back to. The newest four
frames saw zeros in the place of their future, as a window's last frames do; the next step gives
them again, for good.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.export import ExportGraph
from model_export.weights import FREQUENCY_STRIDE, BandContext, PastContext, WeightsNetwork
from service.doa.features import NUM_FEATURES
from service.inference.weights_stream import CONTEXT_FRAMES, LOOKAHEAD_FRAMES

NUM_CONVOLUTIONS = 4
"""Of the network's blocks, those that look ahead"""
STATES = ("past_two", "band_first", "band_second", "past_four", "past_eight")


class StreamingWeightsNetwork(nn.Module):
    """One step of a ``WeightsNetwork``, whose parameters it shares."""

    def __init__(self, network: WeightsNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        features: Tensor,
        past_two: Tensor,
        band_first: Tensor,
        band_second: Tensor,
        past_four: Tensor,
        past_eight: Tensor,
    ) -> tuple[Tensor, ...]:
        """Weights and attentions of the newest L + 4 frames, then the five new states.

        Parameters
        ----------
        features : (B, 5, F, 8 + L)
        past_two, past_four, past_eight : (B, 32, F/4, 4 or 8 or 16)
        band_first, band_second : (B, 32, 4)
        """
        batch, _, bins, frames = features.shape
        height = torch.linspace(-1, 1, bins).reshape(1, 1, bins, 1).expand(batch, 1, bins, frames)
        hidden = torch.cat([features, height], 1)
        blocks = list(self.network.blocks)
        for block in blocks[:NUM_CONVOLUTIONS]:
            hidden = block(hidden)
        hidden = hidden[..., LOOKAHEAD_FRAMES:]  # they saw the convolutions' left edge
        following: list[Tensor] = []
        queue = [past_two, band_first, band_second, past_four, past_eight]
        for block in blocks[NUM_CONVOLUTIONS:]:
            if isinstance(block, PastContext):
                joined = torch.cat([queue.pop(0), hidden], -1)
                following.append(_kept(joined, block.reach))
                hidden = F.relu(hidden + block.norm(block.convolution(joined)))
            else:
                assert isinstance(block, BandContext)
                first = torch.cat([queue.pop(0), hidden.mean(2)], -1)
                second = torch.cat([queue.pop(0), F.relu(block.first(first))], -1)
                following += [_kept(first, block.reach), _kept(second, block.reach)]
                hidden = hidden + block.second(second)[:, :, None]
        weights, attention = self.network.cells(hidden)
        return (weights, attention, *following)

    def initial_state(self, batch: int, bins: int) -> list[Tensor]:
        """Zeros, as the convolutions of a window see before its beginning."""
        state = []
        for block in list(self.network.blocks)[NUM_CONVOLUTIONS:]:
            if isinstance(block, PastContext):
                channels = block.convolution.in_channels
                rows = bins // FREQUENCY_STRIDE
                state.append(torch.zeros(batch, channels, rows, block.reach))
            else:
                assert isinstance(block, BandContext)
                shape = (batch, block.first.in_channels, block.reach)
                state += [torch.zeros(shape), torch.zeros(shape)]
        return state


def _kept(joined: Tensor, reach: int) -> Tensor:
    """The last ``reach`` frames before those that the next step gives again."""
    return joined[..., joined.shape[-1] - LOOKAHEAD_FRAMES - reach : -LOOKAHEAD_FRAMES]


def stream_graph(network: WeightsNetwork, bins: int) -> ExportGraph:
    """Features and state to weights, attentions and the next state."""
    streaming = StreamingWeightsNetwork(network)
    features = torch.zeros(2, NUM_FEATURES, bins, CONTEXT_FRAMES + 6)
    state = streaming.initial_state(2, bins)
    return ExportGraph(
        streaming,
        (features, *state),
        ("features", *STATES),
        ("weights", "attention", *(f"next_{name}" for name in STATES)),
        ({0: "batch", 3: "frames"}, *({0: "batch"} for _ in STATES)),
    )
