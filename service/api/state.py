"""What the endpoints share: settings, worker threads, loaded models."""

from __future__ import annotations

from dataclasses import dataclass, field

from anyio import CapacityLimiter
from fastapi import Request

from service.api.stream_workers import StreamWorkers
from service.api.workers import WorkerPool
from service.audio import AudioLimits
from service.auth import Keys
from service.errors import Draining, NotReady
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
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
    noise_checks: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))
    """The largest profile takes some hundred megabytes while it is checked"""
    keys: Keys = field(default_factory=Keys)
    """Who may do what"""

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
