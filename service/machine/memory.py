"""The C library's allocator, tuned for many short-lived arrays of a megabyte.

Where the library lacks these calls (only glibc has both), nothing happens.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

M_TRIM_THRESHOLD = -1
M_TOP_PAD = -2
M_MMAP_THRESHOLD = -3
M_MMAP_MAX = -4
M_ARENA_MAX = -8
LARGEST_KEPT = 32 * 2**20
"""Bytes of the largest arrays kept, the most that glibc allows; the system zeroes larger ones"""
WINDOWS_KEPT = 64 * 2**20
"""Bytes kept at the end of the heap for windows: a few of them fit"""
STREAMS_KEPT = 4 * 2**20
"""Bytes kept at the end of the heap for streams, whose steps take less"""

_library = ctypes.CDLL(None)
_mallopt: Callable[[int, int], object] = getattr(_library, "mallopt", lambda _what, _value: None)
_trim: Callable[[int], object] = getattr(_library, "malloc_trim", lambda _keep: None)


def keep_freed_memory(most: int = WINDOWS_KEPT) -> None:
    """Let the process reuse freed arrays instead of asking the system for zeroed pages.

    A window's arrays are above the size from which glibc maps each one afresh; page faults would
    take a fifth of the window's time.
    """
    _mallopt(M_MMAP_THRESHOLD, LARGEST_KEPT)
    _mallopt(M_TRIM_THRESHOLD, most)


def keep_all_memory() -> None:
    """Never return memory to the system: for a command that computes and then ends.

    A step's tensors are above the size that ``keep_freed_memory`` can keep, and the system gives
    each back as zeroed pages: that was nearly half of a step of the paper's network.
    """
    _mallopt(M_MMAP_MAX, 0)
    _mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
    _mallopt(M_TOP_PAD, 200 * 2**20)


def share_one_heap() -> None:
    """Let all threads allocate from one heap; call it before there are threads.

    glibc else gives threads heaps of their own, each of which keeps what a burst left in it: an
    eighth of the service's memory. Its threads wait for disks and workers, not for the heap.
    """
    _mallopt(M_ARENA_MAX, 1)


def give_back_memory() -> None:
    """Return unused memory to the system, after a stream, a recording or a reload.

    The process would otherwise keep a long window's memory for a next one that may never come.
    """
    _trim(0)
