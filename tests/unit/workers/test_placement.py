"""Heavy streams are kept from ordinary ones; what no worker can carry is refused."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from neuralmusic.errors import InvalidOption, Overloaded
from service.observability.metrics import Metrics
from service.streaming.cost import HEAVY_STEP_S, ORDINARY, StreamCost
from service.workers.stream_pool import ENOUGH, StreamWorker, StreamWorkers

HEAVY = StreamCost(0.6, 0.6)
BUSY = StreamCost(0.3, 0.006)
"""Heavy, but in short steps"""
IMPOSSIBLE = StreamCost(1.2, 0.1)


@pytest.fixture
def workers_of(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[StreamWorkers]]:
    """Pools whose workers have no process."""

    class Pool(StreamWorkers):
        def _started_now(self) -> StreamWorker:
            worker = StreamWorker.__new__(StreamWorker)
            worker.costs, worker.lost, worker.retired = [], False, False
            self._workers.append(worker)
            return worker

    return Pool  # type: ignore[return-value]


def test_ordinary_streams_fill_workers_one_after_the_other(
    workers_of: type[StreamWorkers],
) -> None:
    pool = workers_of(2, Metrics())
    held = [pool.assign() for _ in range(2 * ENOUGH + 3)]
    assert len({id(worker) for worker in held[:ENOUGH]}) == 1
    assert len({id(worker) for worker in held}) == 2
    loads = [worker.sessions for worker in pool._current()]
    assert abs(loads[0] - loads[1]) <= 1


def test_heavy_streams_and_robots_never_meet(workers_of: type[StreamWorkers]) -> None:
    for first_heavy in (True, False):
        pool = workers_of(2, Metrics())
        order = [HEAVY, ORDINARY, ORDINARY] if first_heavy else [ORDINARY, ORDINARY, HEAVY]
        held = [(pool.assign(cost), cost) for cost in order]
        heavy = {id(worker) for worker, cost in held if cost.heavy}
        assert heavy.isdisjoint({id(worker) for worker, cost in held if not cost.heavy})
        with pytest.raises(Overloaded, match="60% of a core"):
            pool.assign(HEAVY)  # 1.2 cores
        for _ in range(3 * ENOUGH):
            assert id(pool.assign()) not in heavy
        for worker, cost in held:
            pool.release(worker, cost)


def test_a_worker_is_left_to_robots(workers_of: type[StreamWorkers]) -> None:
    pool = workers_of(3, Metrics())
    for _ in range(2):
        pool.assign(HEAVY)
    with pytest.raises(Overloaded):
        pool.assign(HEAVY)
    assert not pool.assign().heavy


def test_a_single_worker_takes_what_does_not_hold_up_the_others(
    workers_of: type[StreamWorkers],
) -> None:
    pool = workers_of(1, Metrics())
    pool.assign()
    assert BUSY.heavy
    assert BUSY.step_s < HEAVY_STEP_S
    pool.assign(BUSY)
    with pytest.raises(Overloaded):
        pool.assign(HEAVY)
    alone = workers_of(1, Metrics())
    worker = alone.assign(HEAVY)
    with pytest.raises(Overloaded):
        alone.assign()
    alone.release(worker, HEAVY)
    alone.assign()


def test_what_no_worker_can_carry_is_refused_for_good(workers_of: type[StreamWorkers]) -> None:
    pool = workers_of(8, Metrics())
    with pytest.raises(InvalidOption, match=r"1\.2 cores.*output\.interval_ms"):
        pool.assign(IMPOSSIBLE)
    assert pool._current() == []


def test_a_stream_that_becomes_heavy_must_not_crowd_out_others(
    workers_of: type[StreamWorkers],
) -> None:
    pool = workers_of(2, Metrics())
    worker = pool.assign()
    pool.change(worker, ORDINARY, HEAVY)  # alone
    assert worker.costs == [HEAVY]
    pool.change(worker, HEAVY, ORDINARY)
    pool.assign()
    with pytest.raises(Overloaded, match="another session"):
        pool.change(worker, ORDINARY, HEAVY)
    with pytest.raises(InvalidOption):
        pool.change(worker, ORDINARY, IMPOSSIBLE)
    assert worker.costs == [ORDINARY, ORDINARY]
