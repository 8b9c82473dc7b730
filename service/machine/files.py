"""How many files the process may have open, sockets among them."""

from __future__ import annotations

import errno
import sys
from contextlib import suppress

TOO_MANY_FILES = "the service has as many files open as it may: try again later"
UNLIMITED = 2**20
"""Limit to assume if the system sets none"""


def file_limit() -> int:
    """Files that the process may have open now."""
    if sys.platform == "win32":
        return UNLIMITED
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return UNLIMITED if soft == resource.RLIM_INFINITY else soft


def raise_file_limit() -> None:
    """Let the process, and those that it starts, open as many files as the system lets it."""
    if sys.platform == "win32":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(ValueError, OSError):  # macOS says unlimited, but allows less
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def out_of_files(error: object) -> bool:
    """Whether this is what the system says of one file or socket too many."""
    return isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE)
