"""The engine ``ray``: actors on a Ray cluster, which must be able to read the recordings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from service.batch.archive import FoundRecording
from service.batch.plan import Plan
from service.batch.record import Record, RecordingLocalizer, failed
from service.errors import ConfigError, DoaError, WorkerLost


class RecordingActor:
    """A process of the cluster; it loads the bundles when it is first needed."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._localizer: RecordingLocalizer | None = None

    def begin(self) -> DoaError | None:
        """Load the bundles; gives what is wrong with them."""
        try:
            self._localizer = RecordingLocalizer(self._plan)
        except DoaError as error:
            return error
        return None

    def record(self, found: FoundRecording) -> Record:
        """Localize one recording."""
        # Ray started the process again after a recording that brought it down.
        self._localizer = self._localizer or RecordingLocalizer(self._plan)
        return self._localizer.record(found)


def localize_on_ray(
    plan: Plan, recordings: Sequence[FoundRecording], jobs: int | None
) -> Iterator[Record]:
    """Localize recordings in actors; yields records as they are done.

    Connects to the cluster of ``RAY_ADDRESS`` or of this machine, or starts one for this run.

    Parameters
    ----------
    jobs : int, optional
        Actors, of one CPU each; by default the cluster's CPUs.

    Raises
    ------
    ConfigError
        If Ray is not installed.
    DoaError
        If the actors cannot begin.
    """
    ray = _ray()
    ours = not ray.is_initialized()
    if ours:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        count = min(jobs or int(ray.cluster_resources().get("CPU", 1)), len(recordings))
        kind = ray.remote(num_cpus=1, max_restarts=-1)(RecordingActor)
        sent = ray.put(plan)
        actors = [kind.remote(sent) for _ in range(count)]
        error = ray.get(actors[0].begin.remote())
        if error is not None:
            raise error
        yield from _records(ray, plan, actors, deque(recordings))
    finally:
        if ours:
            ray.shutdown()


def _records(
    ray: Any, plan: Plan, actors: list[Any], waiting: deque[FoundRecording]
) -> Iterator[Record]:
    """One recording at a time for every actor, so that a lost one tells which it was at."""
    running: dict[Any, tuple[Any, FoundRecording]] = {}
    idle = list(actors)
    while waiting or running:
        while waiting and idle:
            actor, found = idle.pop(), waiting.popleft()
            running[actor.record.remote(found)] = actor, found
        (done,), _ = ray.wait(list(running), num_returns=1)
        actor, found = running.pop(done)
        idle.append(actor)
        try:
            yield ray.get(done)
        except ray.exceptions.RayActorError:
            yield failed(found, plan, WorkerLost(LOST))


LOST = (
    "the process that localized this recording ended: the file may be damaged, or memory short; "
    "run the same command again to try it once more"
)


def _ray() -> Any:
    try:
        from ray import exceptions, init  # noqa: F401
    except ImportError:
        raise ConfigError(
            "--engine ray needs Ray: pip install 'neuralmusic[ray]', or take --engine local"
        ) from None
    import ray

    return ray
