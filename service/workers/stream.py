"""A worker process that computes streams: work comes in over a socket, what came of it goes out.

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
"""Share of the time that looks at channels may take: a tenth of a second slows the results of all
streams of this worker, so with many streams they take turns"""

TIDY_EVERY_S = 10.0
"""Seconds after which freed memory between the streams' arrays goes back to the system: what
sessions keep lies among what steps free, and as much again would stay"""


def work_until_end(link: Link, host: StreamHost) -> None:
    """Do work in the order in which it comes, looks at channels beside it."""
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
