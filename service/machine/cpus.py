"""How many CPUs this process may use: its affinity, and the quota of its control group.

A container's quota shows neither in ``os.cpu_count`` nor in the affinity. A program that counts
those starts a thread for every CPU of the host and is throttled for most of every period.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

CONTROL_GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
CONTROLLERS = ("cpu", "cpu,cpuacct")
"""Folders where distributions mount the controller of version 1"""


def usable_cpus() -> int:
    """CPUs that this process may use, at least one: its affinity, or its quota rounded up."""
    try:
        count = len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        count = os.cpu_count() or 1
    return max(1, math.ceil(min(count, cpu_quota())))


def cpu_quota(root: Path = CONTROL_GROUPS, membership: Path = MEMBERSHIP) -> float:
    """CPUs that this process's control groups of either version allow; inf without a limit.

    The parents of a group limit it as well, so the smallest quota on the way up counts. In a
    container the group's own folder is the root or is hidden, so the root is always read.

    Parameters
    ----------
    root : Path
        Folder where the control groups are mounted.
    membership : Path
        ``/proc/self/cgroup``.

    Notes
    -----
    Linux, ``Documentation/admin-guide/cgroup-v2.rst`` (``cpu.max``) and
    ``Documentation/scheduler/sched-bwc.rst`` (``cpu.cfs_quota_us``, -1 without a limit).
    """
    unified, legacy = _groups(membership)
    quotas = [_unified_quota(root / folder) for folder in _upwards(unified)]
    for controller in CONTROLLERS:
        quotas += [_legacy_quota(root / controller / folder) for folder in _upwards(legacy)]
    return min(quotas)


def _groups(membership: Path) -> tuple[PurePosixPath, PurePosixPath]:
    """This process's group in the unified hierarchy and that of the version 1 controller."""
    unified = legacy = PurePosixPath("/")
    try:
        lines = membership.read_text().splitlines()
    except OSError:  # not Linux
        return unified, legacy
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            unified = PurePosixPath(path)
        elif "cpu" in controllers.split(","):
            legacy = PurePosixPath(path)
    return unified, legacy


def _upwards(group: PurePosixPath) -> Iterator[PurePosixPath]:
    """A group and all its parents, relative to the hierarchy's root."""
    yield from (each.relative_to("/") for each in (group, *group.parents) if ".." not in each.parts)


def _unified_quota(folder: Path) -> float:
    try:
        quota, period = (folder / "cpu.max").read_text().split()
        return int(quota) / int(period)
    except (OSError, ValueError):  # no such file, as in the root of a host, or a quota of "max"
        return math.inf


def _legacy_quota(folder: Path) -> float:
    try:
        quota = int((folder / "cpu.cfs_quota_us").read_text())
        period = int((folder / "cpu.cfs_period_us").read_text())
    except (OSError, ValueError):
        return math.inf
    return quota / period if quota > 0 else math.inf
