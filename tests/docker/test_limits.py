"""A container's limits: processes and threads follow the CPUs that it may use."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from running_containers import Container, wait_for

pytestmark = pytest.mark.docker

RunContainer = Callable[..., Container]
WORKERS = (
    "from service.settings import Settings; s = Settings(); print(s.workers, s.stream_workers)"
)
THREADS = """
import os
from service.machine.environment import prepare_process
prepare_process()
import numpy as np
a = np.random.default_rng(0).standard_normal((400, 400))
np.linalg.eigh(a @ a.T)
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.parametrize(
    ("limit", "workers"),
    [(("--cpus", "1"), 1), (("--cpus", "0.5"), 1), (("--cpuset-cpus", "0"), 1)],
)
def test_there_are_as_many_workers_as_cpus_may_be_used(
    run_container: RunContainer, limit: tuple[str, str], workers: int
) -> None:
    running = run_container(*limit)
    assert running.run("python3", "-c", WORKERS).split() == [str(workers)] * 2


def test_linear_algebra_starts_no_threads_of_its_own(run_container: RunContainer) -> None:
    running = run_container()
    assert running.run("python3", "-c", THREADS).strip() == "1"


def test_it_runs_within_half_a_gigabyte_and_few_processes(run_container: RunContainer) -> None:
    running = run_container("--memory", "512m", "--pids-limit", "64", "--cpus", "1")
    wait_for(f"{running.url}/readyz")
    assert not running.facts["State"]["OOMKilled"]
