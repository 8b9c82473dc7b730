"""What the endpoints share: settings, worker processes, loaded models, metrics."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import anyio.to_thread
from anyio import CapacityLimiter
from fastapi import Request

from neuralmusic.errors import DoaError, NotReady, ReloadRefused
from service.access.keys import Keys
from service.api.reloads import Reloads, within
from service.api.replicas import Replicas
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

LOAD_S = 30.0
"""Seconds in which a reload must have read and tested all bundles"""
TEND_S = 1.0
"""Seconds between looks for workers that ended"""
MOST_TEND_S = 30.0
"""The same while none comes up"""
QUIET_LOOKS = 3
"""Looks at a service without streams and uploads after which what they took is given back"""


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
    replicas: Replicas = field(default_factory=Replicas)
    """The processes that serve behind the same address"""
    _key_reloads: Reloads[None] = field(init=False)
    _model_reloads: Reloads[BundleRegistry] = field(init=False)
    _tending: asyncio.Task[None] | None = None

    def __post_init__(self) -> None:
        self._key_reloads = Reloads(self._reload_keys)
        self._model_reloads = Reloads(self._reload_models)
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
            replicas=Replicas(settings.peers),
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
        """Start a worker of each kind, so that the first client does not wait for it.

        From then on one of each is kept.

        Raises
        ------
        WorkerLost
            If one does not come up.
        """
        log.info("the models are loaded: %s", self.registry)
        await asyncio.gather(self.stream_workers.start(), self.recording_workers.start())
        self._tending = asyncio.create_task(self._tend())

    async def _tend(self) -> None:
        """Replace workers that end between two looks; the seldomer, the longer there is none.

        Some time after the last stream or upload, give back the memory that they took.
        """
        pause, quiet = TEND_S, 0
        while True:
            await asyncio.sleep(pause)
            try:
                self.stream_workers.tend()
                if self.recording_workers.lacking:
                    await anyio.to_thread.run_sync(self.recording_workers.tend)
            except OSError as error:
                log.error("no worker can be started: %s", error)
            pause = TEND_S if self._has_workers else min(2 * pause, MOST_TEND_S)
            busy = self.streams.running or self.recording_workers.admitted
            quiet = 0 if busy else quiet + 1
            if quiet == QUIET_LOOKS:
                give_back_memory()

    @property
    def _has_workers(self) -> bool:
        """False where workers are kept, and one of the kinds has none that is ready."""
        if self._tending is None:
            return True
        return self.stream_workers.ready and self.recording_workers.ready

    async def reload(self) -> BundleRegistry:
        """Read the keys, then the bundles again, verify and self-test, and serve with them.

        Keys are in force before any bundle is read: whose was taken away is out at once. Running
        streams and recordings keep the bundles that they began with.

        Raises
        ------
        ReloadRefused
            If they cannot be used, or not read in time; what was read earlier goes on then.
        """
        await self._key_reloads.ask()
        return await self._model_reloads.ask()

    async def _reload_keys(self) -> None:
        with self._refusing("keys"):
            await within(LOAD_S, self.keys.reload)

    async def _reload_models(self) -> BundleRegistry:
        with self._refusing("models"):
            registry = await within(LOAD_S, load_registry, self.settings)
            await self._renew_workers(Setup(self.settings, registry.files))
        self.registry = registry
        give_back_memory()
        self.metrics.reloaded(ok=True)
        log.info("the models were reloaded: %s", registry)
        return registry

    @contextmanager
    def _refusing(self, what: str) -> Iterator[None]:
        """Count, log and refuse a reload that fails."""
        try:
            yield
        except (DoaError, OSError) as error:
            detail = error.detail if isinstance(error, DoaError) else str(error)
            if isinstance(error, TimeoutError):
                detail = f"reading them took longer than {LOAD_S:g} s: look at their disk"
            self.metrics.reloaded(ok=False)
            log.error("the %s were not reloaded: %s", what, detail)
            raise ReloadRefused(f"{detail}; the {what} that were loaded go on serving") from error

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
        if self._tending is not None:
            self._tending.cancel()
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
        loaded = self.registry is not None and self._has_workers
        return loaded and not self.lifecycle.reached(Phase.LEAVING)

    def check_ready(self) -> None:
        """Raise NotReady or Draining where new work should go elsewhere."""
        self.admit()
        self.lifecycle.check(Phase.LEAVING)
        if not self._has_workers:
            raise NotReady("no process that computes is ready: try again in a moment")

    def admit(self) -> BundleRegistry:
        """The loaded bundles for new work; raises Draining once the service shuts down."""
        self.lifecycle.check(Phase.DRAINING)
        return self.models()


def state_of(request: Request) -> ServiceState:
    """The state of the application that serves a request."""
    state: ServiceState = request.app.state.service
    return state
