"""A service at rest: when it has come to it, and whether anything is left of what was before."""

from __future__ import annotations

import time

import httpx2

from .served import PATIENCE_S, Footprint, Served

MEMORY_MB = 20.0
"""Most memory, in MB, above the amount before"""
ALIKE = 10
"""Successive looks that must be alike"""


def settled(served: Served) -> Footprint:
    """The footprint once no session runs and nothing comes or goes any more."""
    deadline = time.monotonic() + PATIENCE_S
    alike, last = 0, _look(served)
    while alike < ALIKE:
        assert time.monotonic() < deadline, f"no rest: {last}"
        now = _look(served)
        same = (now.processes, now.threads, now.files) == (last.processes, last.threads, last.files)
        alike = alike + 1 if same else 0
        last = now
    return last


def returned(served: Served, before: Footprint) -> Footprint:
    """The footprint once it is that of before, or after a minute."""
    deadline = time.monotonic() + PATIENCE_S
    while leftovers(now := _look(served), before) and time.monotonic() < deadline:
        pass
    return now


def leftovers(now: Footprint, before: Footprint) -> list[str]:
    """What there is more than before."""
    found = []
    if now.memory_mb > before.memory_mb + MEMORY_MB:
        found.append(f"{now.memory_mb - before.memory_mb:.0f} MB")
    for name in ("processes", "threads", "files"):
        more = getattr(now, name) - getattr(before, name)
        if more > 0:
            found.append(f"{more} {name}")
    if now.temporary_files:
        found.append(f"{now.temporary_files} temporary files")
    return found


def _look(served: Served) -> Footprint:
    """The footprint; the request that comes first is answered by a service that is alive."""
    sessions = httpx2.get(f"{served.url}/sessions", timeout=PATIENCE_S).json()["sessions"]
    found = served.footprint()
    running = sum(each["state"] == "running" for each in sessions)
    # A session that still runs holds what it holds: it counts as a process too many.
    return Footprint(
        found.memory_mb,
        found.processes + running,
        found.threads,
        found.files,
        found.temporary_files,
    )
