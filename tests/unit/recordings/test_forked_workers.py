"""Work in forked helpers: results, their order, and what is left when a process dies."""

from __future__ import annotations

import errno
import multiprocessing
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing.synchronize import SemLock
from unittest.mock import Mock

import numpy as np
import pytest

from neuralmusic.errors import WorkerLost
from service.doa.types import FloatArray
from service.recordings.forked_workers import AHEAD, FEW, in_order

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="helpers are forked on Linux only")

MANY = 5 * FEW


def where(number: int) -> tuple[int, int]:
    return number * number, os.getpid()


def test_results_come_in_the_inputs_order_from_several_processes() -> None:
    done = list(in_order(where, range(MANY), 2))
    assert [(given, square) for given, (square, _) in done] == [(n, n * n) for n in range(MANY)]
    helpers = {pid for _, (_, pid) in done}
    assert 1 <= len(helpers) <= 2
    assert os.getpid() not in helpers


@pytest.mark.parametrize(("count", "processes"), [(FEW - 1, 2), (MANY, 1), (0, 2)])
def test_few_inputs_and_one_process_are_the_callers_own(count: int, processes: int) -> None:
    done = list(in_order(where, range(count), processes))
    assert [given for given, _ in done] == list(range(count))
    assert {pid for _, (_, pid) in done} <= {os.getpid()}


def test_where_the_system_has_no_semaphores_the_caller_works_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A container without ``/dev/shm``."""
    lacks = OSError(errno.ENOENT, "No such file or directory")
    monkeypatch.setattr(SemLock, "__init__", Mock(side_effect=lacks))
    done = list(in_order(where, range(MANY), 2))
    assert [given for given, _ in done] == list(range(MANY))
    assert {pid for _, (_, pid) in done} == {os.getpid()}


def test_work_need_not_be_pickled_and_arrays_are_as_they_were() -> None:
    scale = np.float32(3)
    arrays = [np.full((2, 5), index, np.float32) for index in range(MANY)]

    def scaled(array: FloatArray) -> FloatArray:
        return array * scale

    for array, result in in_order(scaled, arrays, 2):
        np.testing.assert_array_equal(result, 3 * array)


def test_arrays_larger_than_the_first_ones_come_through() -> None:
    rng = np.random.default_rng(0)
    arrays = [rng.standard_normal((index, 3 + index)) for index in range(MANY)]
    for array, result in in_order(np.negative, arrays, 2):
        np.testing.assert_array_equal(result, -array)


def test_inputs_are_taken_as_results_are() -> None:
    taken = 0

    def inputs() -> Iterator[int]:
        nonlocal taken
        for number in range(MANY):
            taken += 1
            yield number

    for done, _ in enumerate(in_order(where, inputs(), 2)):
        assert taken <= max(FEW, done + 2 * AHEAD + 1)


def test_what_work_raises_reaches_the_caller_and_no_helper_stays() -> None:
    def fails(number: int) -> int:
        if number == FEW + 2:
            raise ValueError("window eleven")
        return number

    done = []
    with pytest.raises(ValueError, match="window eleven"):
        done.extend(given for given, _ in in_order(fails, range(MANY), 2))
    assert not multiprocessing.active_children()


def test_helpers_end_where_nobody_wants_the_rest() -> None:
    results = in_order(where, range(MANY), 2)
    next(results)
    assert multiprocessing.active_children()
    results.close()  # type: ignore[attr-defined]
    assert not multiprocessing.active_children()


def test_a_helper_that_is_killed_is_a_lost_worker() -> None:
    def killed(number: int) -> int:
        if number == FEW:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    with pytest.raises(WorkerLost, match="send it again"):
        list(in_order(killed, range(MANY), 2))
    assert not multiprocessing.active_children()


def test_helpers_do_not_outlive_a_killed_caller() -> None:
    script = (
        "import os\n"
        "from itertools import count\n"
        "from service.recordings.forked_workers import in_order\n"
        "for _, pid in in_order(lambda _: os.getpid(), count(), 2): print(pid, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as caller:
        assert caller.stdout is not None
        helper = os.pidfd_open(int(caller.stdout.readline()))
        try:
            caller.kill()
            ended, _, _ = select.select([helper], [], [], 10)
            assert ended
        finally:
            os.close(helper)
