"""A worker process that localizes recordings, one after the other.

The service starts it as ``python -m service.workers.recording FD``. Decoders of untrusted files
run only here: one that crashes or hangs takes down a single request.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import BinaryIO

from neuralmusic.errors import UNEXPECTED, DoaError, WorkerLost
from service.inference.registry import BundleRegistry
from service.machine.memory import give_back_memory, keep_freed_memory
from service.recordings.job import (
    Localized,
    Outcome,
    RecordingJob,
    Refused,
    Report,
    localize_file,
)
from service.settings import Settings
from service.workers.link import READY, TAKEN, Link, run_worker
from service.workers.warm_up import warm_up

log = logging.getLogger(__name__)


class Unwanted(Exception):
    """Nobody waits for the answer."""


def work_until_end(link: Link, registry: BundleRegistry, processes: int = 1) -> None:
    """Take jobs with their files; the service answers every report with whether to continue."""

    def report(message: Report) -> None:
        link.send(message)
        if not link.receive():
            raise Unwanted

    while True:
        job, descriptor = link.receive_with_file()
        link.send(TAKEN)
        link.send(
            _outcome(
                job,
                descriptor,
                partial(localize_file, registry=registry, report=report, processes=processes),
            )
        )
        give_back_memory()


def _outcome(
    job: RecordingJob,
    descriptor: int | None,
    localize: Callable[[RecordingJob, BinaryIO], tuple[bytes, Mapping[int, int]]],
) -> Outcome | None:
    assert descriptor is not None
    began = time.monotonic()
    try:
        with os.fdopen(descriptor, "rb") as file:
            file.seek(0)
            body, stretches = localize(job, file)
        return Localized(body, stretches, time.monotonic() - began)
    except Unwanted:
        return None
    except WorkerLost:
        sys.exit(1)  # as the helper did: the service replaces this worker and logs it
    except DoaError as error:
        return Refused(error)
    except Exception:
        log.exception("the recording failed", extra={"request_id": job.request_id})
        return Refused(DoaError(UNEXPECTED))


def serve(link: Link, settings: Settings, registry: BundleRegistry) -> None:
    """Localize recordings until the service ends."""
    keep_freed_memory()
    warm_up(registry)
    link.send(READY)
    work_until_end(link, registry, settings.processes)


if __name__ == "__main__":
    run_worker(serve)
