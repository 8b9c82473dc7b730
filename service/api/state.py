"""What the endpoints share: settings, worker processes, loaded models, metrics."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field

import anyio.to_thread
from anyio import CapacityLimiter
from fastapi import Request

from neuralmusic.errors import DoaError, NotReady, ReloadRefused
from service.access.keys import Keys
from service.api.spool import Spool
from service.audio.recording import AudioLimits
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
from service.lifecycle import Lifecycle, Phase
from service.machine.memory import give_back_memory
from service.observability.metrics import Gauges, Metrics
from service.observability.traces import Traces
from service.settings import Settings
from service.startup import load_registry
from service.streaming.registry import SessionRegistry
from service.workers.link import Setup
from service.workers.recording_pool import RecordingWorkers
from service.workers.stream_pool import StreamWorkers

log = logging.getLogger(__name__)


@dataclass(slots=True)
class ServiceState:
    """One application's state; ``app.state.service`` holds it."""

    settings: Settings
    recording_workers: RecordingWorkers
    streams: SessionRegistry
    stream_workers: StreamWorkers
    lifecycle: Lifecycle
    registry: BundleRegistry | None = None
    """Loaded bundles; None until they are self-tested"""
    noise: NoiseStore = field(default_factory=NoiseStore)
    """Profiles of robots' own noises"""
    metrics: Metrics = field(default_factory=Metrics)
    traces: Traces = field(default_factory=Traces)
    noise_checks: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))
    """Limits checks to one at a time: the largest profile takes some hundred megabytes"""
    noise_access: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(4))
    """Limits threads in which streams wait for the store"""
    spool: Spool = field(default_factory=Spool)
    """The uploads under way"""
    keys: Keys = field(default_factory=Keys)
    """API keys; they decide who may do what"""
    _reloading: asyncio.Lock = field(default_factory=asyncio.Lock)

    def __post_init__(self) -> None:
        self.metrics.read_from(self.gauges)

    @classmethod
    def of(cls, settings: Settings) -> ServiceState:
        """The state before anything is loaded; ConfigError where an extra is missing."""
        metrics, lifecycle = Metrics(), Lifecycle()
        return cls(
            settings,
            RecordingWorkers(
                settings.workers, settings.queue, settings.stall_timeout_s, metrics, lifecycle
            ),
            SessionRegistry(settings.max_sessions),
            StreamWorkers(settings.stream_workers, metrics),
            lifecycle,
            noise=NoiseStore(settings.noise_folder),
            metrics=metrics,
            traces=Traces(settings.traces),
            keys=Keys(settings.keys),
        )

    def gauges(self) -> Gauges:
        """The gauges at this moment, for a scrape."""
        bundles = self.registry.bundles if self.registry else ()
        return Gauges(
            sessions=self.streams.running,
            max_sessions=self.streams.max_sessions,
            recordings=self.recording_workers.admitted,
            workers={
                "stream": len(self.stream_workers.pids),
                "recording": len(self.recording_workers.pids),
            },
            ready=self.ready,
            models=tuple(bundle.identity for bundle in bundles),
        )

    @property
    def audio_limits(self) -> AudioLimits:
        settings = self.settings
        return AudioLimits(max_channels=settings.max_channels, max_seconds=settings.max_seconds)

    def install(self, registry: BundleRegistry) -> None:
        """Serve with these bundles from the start."""
        self.registry = registry
        setup = Setup(self.settings, registry.files)
        self.stream_workers.setup = self.recording_workers.setup = setup

    async def load(self) -> None:
        """Load the bundles, unless they are loaded, and the noise profiles.

        Raises
        ------
        BundleError, ConfigError
            If the bundles cannot be used.
        """
        await anyio.to_thread.run_sync(self.noise.all)
        if self.registry is None:
            self.install(await anyio.to_thread.run_sync(load_registry, self.settings))

    async def start_workers(self) -> None:
        """Start a worker of each kind, so that the first client need not wait."""
        log.info("the models are loaded: %s", self.registry)
        await asyncio.gather(self.stream_workers.start(), self.recording_workers.start())
        give_back_memory()  # what loading and the self-test took

    async def reload(self) -> BundleRegistry:
        """Read the bundles and the keys again, verify and self-test them, and use them.

        Running streams and recordings keep the bundles that they began with.

        Raises
        ------
        ReloadRefused
            If they cannot be used; everything then stays as it was.
        """
        async with self._reloading:
            try:
                registry = await anyio.to_thread.run_sync(load_registry, self.settings)
                await anyio.to_thread.run_sync(self.keys.reload)
                await self._renew_workers(Setup(self.settings, registry.files))
            except DoaError as error:
                self.metrics.reloaded(ok=False)
                log.error("the models were not reloaded: %s", error.detail)
                raise ReloadRefused(
                    f"{error.detail}; the service keeps the models that it has"
                ) from error
            self.registry = registry
            give_back_memory()
        self.metrics.reloaded(ok=True)
        log.info("the models were reloaded: %s", registry)
        return registry

    async def _renew_workers(self, setup: Setup) -> None:
        """Start workers of both kinds with a new setup, then let new work go to them."""
        prepared = await anyio.to_thread.run_sync(self.recording_workers.prepare, setup)
        try:
            await self.stream_workers.renew(setup)
        except BaseException:
            prepared.end()
            raise
        await anyio.to_thread.run_sync(self.recording_workers.renew, prepared)

    def drain(self) -> None:
        """Begin a graceful shutdown: accept nothing new, end all streams in order."""
        self.lifecycle.enter(Phase.DRAINING)
        self.streams.drain()

    async def stop(self) -> None:
        """End all worker processes, send the last traces."""
        self.lifecycle.enter(Phase.ENDING)
        await self.stream_workers.stop()
        await anyio.to_thread.run_sync(self.recording_workers.stop)
        await anyio.to_thread.run_sync(self.traces.stop)

    def models(self) -> BundleRegistry:
        """The loaded bundles, or NotReady."""
        if self.registry is None:
            raise NotReady("the models are being loaded: try again in a moment")
        return self.registry

    @property
    def ready(self) -> bool:
        """Whether new work may come, as ``/readyz`` answers."""
        return self.registry is not None and not self.lifecycle.reached(Phase.LEAVING)

    def check_ready(self) -> None:
        """Raise NotReady or Draining where new work should go elsewhere."""
        self.admit()
        self.lifecycle.check(Phase.LEAVING)

    def admit(self) -> BundleRegistry:
        """The loaded bundles for new work; raises Draining once the service shuts down."""
        self.lifecycle.check(Phase.DRAINING)
        return self.models()


def state_of(request: Request) -> ServiceState:
    """The state of the application that serves a request."""
    state: ServiceState = request.app.state.service
    return state
