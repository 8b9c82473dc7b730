"""One recording at a time in a worker process of the service, which a recording may crash."""

from __future__ import annotations

from collections.abc import Callable

from neuralmusic.errors import DecodingFailed, DoaError, RecordingUnreadable, WorkerLost
from service.batch.archive import FoundRecording
from service.batch.plan import Plan
from service.batch.record import Record, failed, localized
from service.recordings.job import Progress, Report
from service.workers.recording_pool import RecordingWorker

Told = Callable[[FoundRecording, float], None]
"""Called with a recording and its progress, 0 to 1"""


class BatchWorker:
    """Turns recordings into records; replaces its process when a recording crashes it.

    Raises
    ------
    WorkerLost
        If the process does not start.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._ended = False
        self._worker: RecordingWorker | None = self._start()

    def record(self, found: FoundRecording, told: Told) -> Record:
        """Localize a recording; an error becomes its record.

        Raises
        ------
        WorkerLost
            If a new process does not start.
        """
        plan = self._plan

        def check(report: Report) -> None:
            if isinstance(report, Progress):
                told(found, report.share)

        worker = self._worker = self._worker or self._start()
        try:
            with found.place.open("rb") as file:
                return localized(found, plan, worker.localize(plan.job, file, check))
        except (DecodingFailed, WorkerLost) as error:
            self._worker = None
            return failed(found, plan, error)
        except DoaError as error:
            return failed(found, plan, error)
        except OSError as error:
            return failed(found, plan, RecordingUnreadable(_unreadable(error)))

    def kill(self) -> None:
        """End the process at once, from another thread."""
        self._ended = True
        if self._worker is not None:
            self._worker.kill()

    def end(self) -> None:
        """Stop the process gracefully."""
        if self._worker is not None:
            self._worker.end()

    def _start(self) -> RecordingWorker:
        setup = self._plan.setup
        worker = RecordingWorker(setup, setup.settings.stall_timeout_s)
        worker.wait_ready()
        if self._ended:
            worker.end()
            raise WorkerLost("the run was stopped")
        return worker


def _unreadable(error: OSError) -> str:
    return (
        f"{error.strerror or error}: the file must be readable where it is localized, "
        "then run the same command again"
    )
