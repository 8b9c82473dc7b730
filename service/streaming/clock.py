"""When a stream's results are due, in samples of the analysis."""

from __future__ import annotations

import math
from typing import NamedTuple


class StreamClock(NamedTuple):
    """The position of a stream; sessions and pipelines use the same clock."""

    rate: int
    """Sample rate of the analysis in hertz"""
    ratio: float
    """Sample frames of the stream per sample of the analysis"""
    samples: float = 0.0
    """Stream time of the audio so far in samples, missing audio included"""
    reported: float = -1.0
    """Stream time of the last result in samples, negative before the first"""

    def due(self, interval_ms: int) -> float:
        """Stream time of the next result in samples: multiples of the interval."""
        interval = interval_ms * self.rate / 1000
        return (math.floor(max(self.reported, 0.0) / interval + 1e-9) + 1) * interval

    def frames_needed(self, interval_ms: int) -> int:
        """Sample frames of the stream until the next result is due."""
        return max(1, math.ceil((self.due(interval_ms) - self.samples) * self.ratio))
