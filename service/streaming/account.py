"""The account of a session: audio, results, losses, sources."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from neuralmusic.protocol.server_messages import StreamSource, TrackSummary
from service.streaming.history import History, HistoryEntry, Point
from service.streaming.pipeline import Estimate

MAX_TRACKS = 256
LONGEST_LAG_MS = 10_000
"""Longest lag in the counts; longer ones count as this"""


@dataclass(slots=True)
class _Heard:
    azimuth_deg: float
    first: float
    last: float
    active: float = 0.0


@dataclass(slots=True)
class Account:
    """Figures of one session; memory is bounded."""

    audio_s: float = 0.0
    """Seconds of audio received"""
    results: int = 0
    dropped_s: float = 0.0
    gap_s: float = 0.0
    results_dropped: int = 0
    """Results that the client did not read in time"""
    lag_ms: float = 0.0
    """Milliseconds of lag of the last result"""
    t_end: float = 0.0
    warnings: Counter[str] = field(default_factory=Counter)
    history: History = field(default_factory=History)
    _heard: dict[int, _Heard] = field(default_factory=dict)
    most_lag_ms: float = 0.0
    """Milliseconds of the longest lag of all results"""
    _lags: list[float] = field(default_factory=list)
    _lag_counts: Counter[int] = field(default_factory=Counter)
    """Results by their lag in whole milliseconds, up to ``LONGEST_LAG_MS``"""

    def add(self, estimate: Estimate, sources: Iterable[StreamSource], lag_ms: float) -> None:
        """Add one result with its sources as they are sent."""
        step = estimate.t_end - self.t_end
        self.results += 1
        self.lag_ms, self.t_end = lag_ms, estimate.t_end
        self.most_lag_ms = max(self.most_lag_ms, lag_ms)
        self._lags.append(lag_ms)
        self._lag_counts[min(round(lag_ms), LONGEST_LAG_MS)] += 1
        points = tuple(
            Point(s.id, s.azimuth_deg, s.confidence, s.active, s.elevation_deg) for s in sources
        )
        self.history.append(
            HistoryEntry(round(estimate.t_end, 6), estimate.capture_time_ns, points)
        )
        for point in points:
            heard = self._heard.setdefault(
                point.id, _Heard(point.azimuth_deg, estimate.t_end, estimate.t_end)
            )
            heard.azimuth_deg, heard.last = point.azimuth_deg, estimate.t_end
            heard.active += step if point.active else 0.0
        while len(self._heard) > MAX_TRACKS:
            del self._heard[next(iter(self._heard))]

    def mean_lag_ms(self) -> float:
        """Mean lag of the results since the last call."""
        lags, self._lags = self._lags, []
        return round(sum(lags) / len(lags), 1) if lags else 0.0

    def median_lag_ms(self) -> int:
        """Median lag of all results; 0 before the first."""
        passed = 0
        for lag, count in sorted(self._lag_counts.items()):
            passed += count
            if 2 * passed >= self.results:
                return lag
        return 0

    def tracks(self) -> Iterator[TrackSummary]:
        """The sources, longest heard first."""
        for track, heard in sorted(self._heard.items(), key=lambda item: -item[1].active):
            yield TrackSummary(
                id=track,
                azimuth_deg=heard.azimuth_deg,
                first_s=round(heard.first, 3),
                last_s=round(heard.last, 3),
                active_s=round(heard.active, 3),
            )
