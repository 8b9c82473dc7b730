"""Identities of sources over a recording's windows, from the tracker."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from service.doa.kalman import angle, direction
from service.doa.tracking import Detection, Track, Tracker
from service.inference.results import Source
from service.recordings.results import WindowResult

SAME = math.radians(15.0)
"""Radians between a source and its track at most; a source further from all gets no id"""


def identified(windows: Iterable[WindowResult]) -> Iterator[WindowResult]:
    """The windows with ids on their sources; directions and confidences stay the same."""
    tracker = Tracker()
    for window in windows:
        sources = window.estimate.sources
        detections = [
            Detection(source.azimuth, source.confidence, source.elevation) for source in sources
        ]
        tracks = tracker.update(detections, window.t_end)
        named = tuple(_named(source, tracks) for source in sources)
        yield replace(window, estimate=replace(window.estimate, sources=named))


def _named(source: Source, tracks: Sequence[Track]) -> Source:
    towards = direction(source.azimuth, source.elevation)
    offs = [(angle(track.direction, towards), track.id) for track in tracks if track.active]
    off, track = min(offs, default=(math.inf, None))
    return replace(source, id=track) if off <= SAME else source
