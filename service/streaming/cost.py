"""What a stream costs, estimated from its ``start``: workers are filled by it.

The figures are seconds of one core, measured on a Xeon with AVX-512 whose second core was busy
(``python tests/bench/costs.py``); a free one takes half of them, an older one as much. So they are
good to a factor of two, which is enough to tell a robot's stream (0.07) from one that would take a
whole core.
"""

from __future__ import annotations

from typing import NamedTuple

from neuralmusic.protocol.client_messages import Start
from service.doa.presets import PRESETS

ANALYSIS_S = 0.01
"""A second of STFT and checks, whatever the array"""
CHANNEL_S = 0.00125
"""The same for every microphone"""
SAMPLE_S = 5.5e-8
"""A sample of a microphone that is resampled"""
NEURAL_S = 0.005
"""A result with the network"""
CLASSICAL_S = 0.001
"""A result of a classical method"""
PAIR_S = 3e-5
"""A result for every pair of microphones, ordered, with itself as well: covariances and spectra"""
SPHERE = 1.5
"""Times the price of a result where elevations are searched"""
RATE = 16_000
HEAVY_SHARE = 0.25
"""Share of a core above which a stream is heavy"""
HEAVY_STEP_S = 0.03
"""Seconds of a step above which it is: its worker's other streams wait for so long"""


class StreamCost(NamedTuple):
    """The estimate for one stream."""

    share: float
    """Share of a core"""
    step_s: float
    """Seconds that the work for one result takes"""

    @property
    def heavy(self) -> bool:
        """Whether it must be kept apart from ordinary streams."""
        return self.share > HEAVY_SHARE or self.step_s > HEAVY_STEP_S


ORDINARY = StreamCost(0.07, 0.007)
"""Four microphones, ten results a second"""


def stream_cost(start: Start, interval_ms: int) -> StreamCost:
    """The cost of a stream with a result every ``interval_ms``."""
    microphones = _microphones(start)
    second = ANALYSIS_S + CHANNEL_S * microphones
    if start.audio.sample_rate != RATE:
        second += SAMPLE_S * microphones * start.audio.sample_rate
    result = NEURAL_S if start.method in (None, "neural") else CLASSICAL_S
    result += PAIR_S * microphones**2
    if _searches_the_sphere(start):
        result *= SPHERE
    step = result + second * interval_ms / 1000
    return StreamCost(1000 * step / interval_ms, step)


def _microphones(start: Start) -> int:
    """Number of microphones; that of the channels where the array is unknown, to be refused."""
    if start.array.positions_m is not None:
        return len(start.array.positions_m)
    preset = PRESETS.get(start.array.name or "")
    return preset.num_microphones if preset else start.audio.channels


def _searches_the_sphere(start: Start) -> bool:
    if start.hemisphere != "both":
        return True
    positions = start.array.positions_m
    return positions is not None and len({height for *_, height in positions}) > 1
