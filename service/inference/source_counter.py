"""From candidates to sources: how many there are, and how sure each is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from service.doa.fusion import sigmoid
from service.doa.types import FloatArray
from service.inference.candidates import Candidates
from service.inference.engine import Engine
from service.inference.results import Source, WindowEstimate

LEAST_CONFIDENCE = 0.5
"""Least confidence of a second or third source where their number is estimated: one more likely
wrong than right is left out"""
LEAST_FIRST = 0.2
"""Least confidence of the most confident source: the count decides whether there is any, unless
this direction is almost certainly wrong"""


class SourceCounter:
    """From candidates to sources, by the source-count network.

    Parameters
    ----------
    network : Engine
    together : bool
        Whether the sources' directions are refined once all are known.
    """

    def __init__(self, network: Engine, *, together: bool = True) -> None:
        self._network = network
        self._together = together

    def select(
        self, candidates: Iterable[Candidates], num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Sources of every window; parameters as in ``WeightsLocalizer.estimate``."""
        return [self.sources(window, num_sources, max_sources) for window in candidates]

    def sources(
        self, window: Candidates, num_sources: int | None, max_sources: int
    ) -> WindowEstimate:
        """The sources among one window's candidates, the most confident first."""
        count_logits, confidence_logits = self._network.run([window.descriptors[None]])
        confidence = sigmoid(confidence_logits[0])
        count, least = num_sources, 0.0
        if count is None:
            count, least = min(int(np.argmax(count_logits[0])), max_sources), LEAST_CONFIDENCE
        kept = surest(confidence[: len(window.findings)], count, least)
        found = window.refined(kept) if self._together else [window.directions[i] for i in kept]
        sources = tuple(
            Source(azimuth, float(confidence[index]), elevation=elevation)
            for (azimuth, elevation), index in zip(found, kept, strict=True)
        )
        return WindowEstimate(sources, window.fused, window.image)


def surest(confidence: FloatArray, count: int, least: float) -> list[int]:
    """Those of the first ``count`` candidates that are confident enough, most confident first.

    The most confident needs no more than ``LEAST_FIRST``.
    """
    order = np.argsort(-confidence[:count], kind="stable").tolist()
    kept = [index for index in order[:1] if confidence[index] >= min(least, LEAST_FIRST)]
    return kept + [index for index in order[1:] if confidence[index] >= least]
