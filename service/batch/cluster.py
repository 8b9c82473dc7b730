"""The engine ``ray``: actors on a Ray cluster, which must be able to read the recordings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from neuralmusic.errors import ConfigError, WorkerLost
from service.batch.archive import FoundRecording
from service.batch.plan import Plan
from service.batch.record import Record, failed
from service.batch.worker import BatchWorker

LOST = (
    "the process that localized this recording ended: run the same command again to try it once "
    "more"
)


class RecordingActor:
    """A worker of the cluster; its process survives recordings that crash a decoder."""

    def __init__(self) -> None:
        self._worker: BatchWorker | None = None

    def begin(self, plan: Plan) -> None:
        """Start the worker, or raise WorkerLost."""
        self._worker = BatchWorker(plan)

    def record(self, found: FoundRecording) -> Record:
        """Localize one recording."""
        assert self._worker is not None
        return self._worker.record(found, lambda *_: None)


def localize_on_ray(
    plan: Plan, recordings: Sequence[FoundRecording], jobs: int | None
) -> Iterator[Record]:
    """Localize recordings in actors; yields records as they are done.

    Connects to the cluster of ``RAY_ADDRESS`` or of this machine, or starts one for this run.

    Parameters
    ----------
    jobs : int, optional
        Number of actors, one CPU each; by default the cluster's CPUs.

    Raises
    ------
    ConfigError
        If Ray is not installed.
    WorkerLost
        If an actor does not start.
    """
    ray = _ray()
    ours = not ray.is_initialized()
    if ours:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        count = min(jobs or int(ray.cluster_resources().get("CPU", 1)), len(recordings))
        yield from _records(ray, plan, count, deque(recordings))
    finally:
        if ours:
            ray.shutdown()


def _records(ray: Any, plan: Plan, count: int, waiting: deque[FoundRecording]) -> Iterator[Record]:
    """Give every actor one recording at a time; a dead actor becomes that recording's error.

    An actor gets none before it has started: the cluster may have no CPU for it yet.
    """
    kind, sent = ray.remote(num_cpus=1)(RecordingActor), ray.put(plan)
    beginning = {actor.begin.remote(sent): actor for actor in (kind.remote() for _ in range(count))}
    running: dict[Any, tuple[Any, FoundRecording]] = {}
    while waiting or running:
        (done,), _ = ray.wait([*beginning, *running], num_returns=1)
        record = None
        if done in beginning:
            actor = beginning.pop(done)
            _begun(ray, done)
        else:
            actor, found = running.pop(done)
            record = _record(ray, done)
            if record is None:
                actor = kind.remote()
                beginning[actor.begin.remote(sent)] = actor
                yield failed(found, plan, WorkerLost(LOST))
                continue
        if waiting:
            found = waiting.popleft()
            running[actor.record.remote(found)] = actor, found
        if record is not None:
            yield record


def _begun(ray: Any, done: Any) -> None:
    """Raise WorkerLost where an actor did not start."""
    try:
        ray.get(done)
    except ray.exceptions.RayError as error:
        raise WorkerLost(f"an actor of the Ray cluster did not start: {error}") from error


def _record(ray: Any, done: Any) -> Record | None:
    """A record, or None where its actor died over it."""
    try:
        record: Record = ray.get(done)
    except ray.exceptions.RayActorError:
        return None
    return record


def _ray() -> Any:
    try:
        from ray import exceptions, init  # noqa: F401
    except ImportError:
        raise ConfigError(
            "--engine ray needs Ray: pip install ./client '.[ray]' in the project's folder, or "
            "take --engine local"
        ) from None
    import ray

    return ray
