"""Metrics for Prometheus: a registry per application, gauges read at the scrape.

``docs/monitoring.md`` has the table of names; callers never touch ``prometheus_client``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Histogram,
    ProcessCollector,
    disable_created_metrics,
)
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from neuralmusic.errors import DoaError
from neuralmusic.protocol.server_messages import WarningCode
from service.inference.results import ModelIdentity

Kind = Literal["stream", "recording"]
KINDS: tuple[Kind, ...] = get_args(Kind)

PREFIX = "neuralmusic"
OTHER = "other"
"""Label value for unknown names, so that no client can make up time series"""
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "WEBSOCKET")
ORDERLY_ENDS = ("done", "draining", "vanished")
"""Reasons of sessions that ended without an error; other sessions have the error's code"""
UNTREED_CODES = ("not_found", "method_not_allowed")
"""Codes of problems that are not a ``DoaError``"""

WARNINGS: tuple[str, ...] = get_args(WarningCode)

LATENCY_S = (0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0, 2.0, 5.0)
WORK_S = (
    *(0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
    *(1.0, 2.0, 5.0, 10.0, 30.0, 60.0),
)
BATCH_WINDOWS = (1, 2, 3, 4, 6, 8, 12, 16, 32)

# Each counter would have a second time series with the time of its creation.
disable_created_metrics()  # type: ignore[no-untyped-call]


@dataclass(frozen=True, slots=True)
class Gauges:
    """The service's state at the moment of a scrape."""

    sessions: int = 0
    """Running streams"""
    max_sessions: int = 0
    """Most streams that may run"""
    recordings: int = 0
    """Recordings being localized or waiting"""
    workers: Mapping[Kind, int] = field(default_factory=dict)
    """Running processes by kind"""
    ready: bool = False
    """Whether ``/readyz`` answers 200"""
    models: Iterable[ModelIdentity] = ()
    """Loaded bundles"""


class Metrics:
    """The counters of one application, and gauges that are read at each scrape."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        self._read: Callable[[], Gauges] = Gauges
        ProcessCollector(registry=registry)
        registry.register(_StateCollector(self))

        def counter(name: str, meaning: str, *labels: str) -> Counter:
            return Counter(name, meaning, labels, namespace=PREFIX, registry=registry)

        def histogram(name: str, meaning: str, buckets: Iterable[float], *labels: str) -> Histogram:
            return Histogram(
                name, meaning, labels, namespace=PREFIX, registry=registry, buckets=tuple(buckets)
            )

        self._ended = counter("sessions_ended_total", "Streams that ended, by reason.", "reason")
        audio = counter("audio_seconds_total", "Seconds of audio received.", "kind")
        self._dropped = counter(
            "audio_dropped_seconds_total",
            "Seconds of streams' audio dropped so that results describe the present.",
        )
        inference = histogram(
            "inference_seconds", "Time that a worker spent on one job.", WORK_S, "kind"
        )
        queue = histogram("queue_seconds", "Time that a job waited for its worker.", WORK_S, "kind")
        self._latency = histogram(
            "result_latency_seconds",
            "Seconds from the arrival of a result's last audio until the socket takes the result.",
            LATENCY_S,
        )
        self._lag = histogram(
            "lag_seconds", "Lag of results, as the protocol defines it.", LATENCY_S
        )
        self._batch = histogram(
            "batch_windows", "Windows of a recording computed at a time.", BATCH_WINDOWS
        )
        self._errors = counter("errors_total", "Problems and stream errors, by code.", "code")
        self._warnings = counter("stream_warnings_total", "Warnings of streams, by code.", "code")
        self._requests = counter(
            "requests_total", "Requests and handshakes answered.", "method", "path", "status"
        )
        self._request_time = histogram(
            "request_seconds", "Time until a request was answered.", WORK_S, "path"
        )
        self._lost = counter("workers_lost_total", "Workers that ended unexpectedly.", "kind")
        self._reloads = counter("reloads_total", "Reloads of the models, by outcome.", "outcome")

        # Series begin at 0, so that the first count shows as an increase. They are looked up
        # once: a lookup for every message would cost more than the count.
        self._audio = {kind: audio.labels(kind) for kind in KINDS}
        self._inference = {kind: inference.labels(kind) for kind in KINDS}
        self._queue = {kind: queue.labels(kind) for kind in KINDS}
        for kind in KINDS:
            self._lost.labels(kind)
        for outcome in ("ok", "refused"):
            self._reloads.labels(outcome)
        self._codes = frozenset({*error_codes(), *UNTREED_CODES})
        for code in self._codes:
            self._errors.labels(code)
        for warning in WARNINGS:
            self._warnings.labels(warning)
        for reason in ORDERLY_ENDS:
            self._ended.labels(reason)

    def read_from(self, read: Callable[[], Gauges]) -> None:
        """Call ``read`` for the gauges at every scrape."""
        self._read = read

    def gauges(self) -> Gauges:
        """The gauges now."""
        return self._read()

    def audio(self, kind: Kind, seconds: float) -> None:
        """Count received audio."""
        self._audio[kind].inc(seconds)

    def audio_dropped(self, seconds: float) -> None:
        """Count dropped audio of a stream."""
        self._dropped.inc(seconds)

    def lag(self, seconds: float) -> None:
        """Count one result by its lag."""
        self._lag.observe(seconds)

    def result_sent(self, latency_s: float) -> None:
        """Count one result that the socket took."""
        self._latency.observe(latency_s)

    def session_ended(self, reason: str) -> None:
        """Count the end of a stream: ``done``, ``draining``, ``vanished`` or an error's code."""
        known = reason in self._codes or reason in ORDERLY_ENDS
        self._ended.labels(reason if known else OTHER).inc()

    def refused(self, code: str) -> None:
        """Count a problem or an error by its code."""
        self._errors.labels(code if code in self._codes else OTHER).inc()

    def warned(self, code: str) -> None:
        """Count a stream's warning by its code."""
        self._warnings.labels(code if code in WARNINGS else OTHER).inc()

    def requested(self, method: str, path: str, status: int, seconds: float | None) -> None:
        """Count a request.

        Parameters
        ----------
        method : str
            ``WEBSOCKET`` for a handshake.
        path : str
            Template of the route, or ``other``.
        seconds : float, optional
            Time until the answer; None for a stream, which has no single answer.
        """
        method = method if method in METHODS else OTHER
        self._requests.labels(method, path, str(status)).inc()
        if seconds is not None:
            self._request_time.labels(path).observe(seconds)

    def worked(self, kind: Kind, queued_s: float, worked_s: float) -> None:
        """Count one job of a worker: how long it waited and how long it took."""
        self._queue[kind].observe(queued_s)
        self._inference[kind].observe(worked_s)

    def batch(self, windows: int) -> None:
        """Count the windows of a recording that were computed together."""
        self._batch.observe(windows)

    def worker_lost(self, kind: Kind) -> None:
        """Count a worker that ended unexpectedly."""
        self._lost.labels(kind).inc()

    def reloaded(self, *, ok: bool) -> None:
        """Count a reload of the models, accepted or refused."""
        self._reloads.labels("ok" if ok else "refused").inc()

    def exposition(self, accept: str) -> tuple[bytes, str]:
        """All metrics as text and its media type, OpenMetrics where ``accept`` asks for it."""
        encode, media_type = choose_encoder(accept)
        return encode(self.registry), media_type


class _StateCollector(Collector):
    """Gauges read from the service's state, so that no second copy can go stale."""

    def __init__(self, metrics: Metrics) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        now = self._metrics.gauges()
        yield _gauge("sessions", "Running streams.", now.sessions)
        yield _gauge("max_sessions", "Most streams that may run.", now.max_sessions)
        yield _gauge("uploads", "Recordings being localized or waiting.", now.recordings)
        yield _gauge("ready", "1 where the service takes requests, else 0.", now.ready)
        workers = GaugeMetricFamily(f"{PREFIX}_workers", "Worker processes.", labels=["kind"])
        for kind in KINDS:
            workers.add_metric([kind], now.workers.get(kind, 0))
        yield workers
        labels = ("name", "version", "variant", "sha256")
        # A gauge, not prometheus_client's info: that one would add a suffix to the name.
        info = GaugeMetricFamily(f"{PREFIX}_model_info", "1 for every loaded model.", labels=labels)
        for model in now.models:
            info.add_metric([getattr(model, label) for label in labels], 1)
        yield info


def _gauge(name: str, meaning: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"{PREFIX}_{name}", meaning, value=float(value))


def error_codes() -> Iterator[str]:
    """The codes of ``neuralmusic.errors``; the service never sends those of the clients."""
    pending = [DoaError]
    while pending:
        error = pending.pop()
        if error.__module__ == DoaError.__module__:
            yield error.code
        pending += error.__subclasses__()
