"""The quota of control groups, version 1 and 2, on folders as the kernel lays them out."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from service.machine.cpus import cpu_quota, usable_cpus

UNIFIED = "0::/\n"
LEGACY = "9:name=systemd:/\n4:cpu,cpuacct:/\n0::/\n"


def quota(folder: Path, groups: str, files: dict[str, str]) -> float:
    """The quota in a made-up machine: ``/proc/self/cgroup``, and files below ``/sys/fs/cgroup``."""
    membership = folder / "membership"
    membership.write_text(groups)
    for name, text in files.items():
        path = folder / "root" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return cpu_quota(folder / "root", membership)


@pytest.mark.parametrize(
    ("groups", "files", "cpus"),
    [
        (UNIFIED, {"cpu.max": "150000 100000\n"}, 1.5),
        (UNIFIED, {"cpu.max": "max 100000\n"}, math.inf),
        (UNIFIED, {}, math.inf),
        (UNIFIED, {"cpu.max": "nonsense\n"}, math.inf),
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n", "a/cpu.max": "200000 100000\n"}, 2.0),
        ("0::/a/b\n", {"a/b/cpu.max": "50000 100000\n", "a/cpu.max": "200000 100000\n"}, 0.5),
        # A container on a host whose groups it does not see: its own are the root.
        ("0::/../other\n", {"cpu.max": "300000 100000\n"}, 3.0),
        (LEGACY, {"cpu/cpu.cfs_quota_us": "250000", "cpu/cpu.cfs_period_us": "100000"}, 2.5),
        (LEGACY, {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, math.inf),
        (
            LEGACY,
            {"cpu,cpuacct/cpu.cfs_quota_us": "50000", "cpu,cpuacct/cpu.cfs_period_us": "50000"},
            1.0,
        ),
        (
            "4:cpu:/docker/4711\n",
            {
                "cpu/docker/4711/cpu.cfs_quota_us": "400000",
                "cpu/docker/4711/cpu.cfs_period_us": "100000",
            },
            4.0,
        ),
        (
            "4:cpu:/docker/4711\n",
            {"cpu/cpu.cfs_quota_us": "100000", "cpu/cpu.cfs_period_us": "100000"},
            1.0,
        ),
        (LEGACY, {"cpu/cpu.cfs_quota_us": "100000"}, math.inf),
    ],
)
def test_the_smallest_quota_on_the_way_up_counts(
    tmp_path: Path, groups: str, files: dict[str, str], cpus: float
) -> None:
    assert quota(tmp_path, groups, files) == cpus


def test_without_control_groups_there_is_no_quota(tmp_path: Path) -> None:
    assert cpu_quota(tmp_path / "none", tmp_path / "none") == math.inf


def test_there_is_always_a_cpu() -> None:
    assert usable_cpus() >= 1
