"""A worker process that computes streams: jobs come in over a socket, outcomes go out.

The service starts it as ``python -m service.workers.stream FD``.
"""

from __future__ import annotations

import threading
import time
from queue import SimpleQueue

from service.inference.registry import BundleRegistry
from service.machine.memory import STREAMS_KEPT, give_back_memory, keep_freed_memory
from service.settings import Settings
from service.streaming.host import StreamHost
from service.streaming.work import Check, Close, Work
from service.workers.link import READY, Link, run_worker
from service.workers.warm_up import warm_up

CHECK_DUTY = 0.03
"""Most of the time, as a share, for checks of channels: each slows the results of all streams of
this worker for a tenth of a second, so with many streams they take turns"""

TIDY_EVERY_S = 10.0
"""Seconds between returns of freed memory to the system: memory that steps free lies between the
arrays that sessions keep, and would otherwise double what they take"""


def work_until_end(link: Link, host: StreamHost) -> None:
    """Do jobs in the order in which they come, with checks of channels in a thread beside them."""
    checks: SimpleQueue[tuple[int, Check]] = SimpleQueue()
    threading.Thread(target=_check_forever, args=(link, host, checks), daemon=True).start()
    tidied = time.monotonic()
    while True:
        number, work = _received(link)
        if isinstance(work, Check):
            checks.put((number, work))
            continue
        began = time.monotonic()
        outcome = host.perform(work)
        if outcome is not None:
            link.send((number, outcome, time.monotonic() - began))
        if isinstance(work, Close) or began - tidied > TIDY_EVERY_S:
            give_back_memory()
            tidied = began


def _received(link: Link) -> tuple[int, Work]:
    number, work = link.receive()
    return number, work


def _check_forever(link: Link, host: StreamHost, checks: SimpleQueue[tuple[int, Check]]) -> None:
    while True:
        number, check = checks.get()
        began = time.monotonic()
        outcome = host.perform(check)
        seconds = time.monotonic() - began
        try:
            link.send((number, outcome, seconds))
        except OSError:
            return
        time.sleep(seconds * (1 / CHECK_DUTY - 1))


def serve(link: Link, settings: Settings, registry: BundleRegistry) -> None:
    """Compute streams until the service ends."""
    keep_freed_memory(STREAMS_KEPT)
    warm_up(registry)
    link.send((0, READY, 0.0))
    work_until_end(link, StreamHost(registry))


if __name__ == "__main__":
    run_worker(serve)
