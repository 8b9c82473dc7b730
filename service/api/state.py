"""What the endpoints share: settings, worker threads, loaded models, what is counted."""

from __future__ import annotations

from dataclasses import dataclass, field

from fastapi import Request

from service.api.stream_workers import StreamWorkers
from service.api.workers import WorkerPool
from service.audio import AudioLimits
from service.errors import Draining, NotReady
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
from service.metrics import Gauges, Metrics
from service.settings import Settings
from service.streaming.registry import SessionRegistry


@dataclass(slots=True)
class ServiceState:
    """One application's state; ``app.state.service`` holds it."""

    settings: Settings
    workers: WorkerPool
    streams: SessionRegistry
    stream_workers: StreamWorkers
    registry: BundleRegistry | None = None
    """None until the bundles are loaded and self-tested"""
    noise: NoiseStore = field(default_factory=NoiseStore)
    """Profiles of robots' own noises"""
    metrics: Metrics = field(default_factory=Metrics)

    def __post_init__(self) -> None:
        self.metrics.read_from(self.gauges)

    def gauges(self) -> Gauges:
        """What a scrape sees of this moment."""
        bundles = self.registry.bundles if self.registry else ()
        return Gauges(
            sessions=self.streams.running,
            max_sessions=self.streams.max_sessions,
            uploads=self.workers.admitted,
            workers={"stream": len(self.stream_workers.pids), "file": self.workers.count},
            ready=self.registry is not None and not self.streams.draining,
            models=tuple(bundle.identity for bundle in bundles),
        )

    @property
    def audio_limits(self) -> AudioLimits:
        settings = self.settings
        return AudioLimits(max_channels=settings.max_channels, max_seconds=settings.max_seconds)

    def models(self) -> BundleRegistry:
        """The loaded bundles, or NotReady."""
        if self.registry is None:
            raise NotReady("the models are being loaded: try again in a moment")
        return self.registry

    def admit(self) -> BundleRegistry:
        """The loaded bundles for something new; raises Draining once the service shuts down."""
        if self.streams.draining:
            raise Draining("the service is shutting down: try again in a moment")
        return self.models()


def state_of(request: Request) -> ServiceState:
    """The state of the application that serves a request."""
    state: ServiceState = request.app.state.service
    return state
