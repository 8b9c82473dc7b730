"""The progress of ``neuralmusic batch``: a bar on a terminal, and every error as a line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from neuralmusic.cli.terminal import line

if TYPE_CHECKING:
    from service.batch.archive import FoundRecording
    from service.batch.record import Record


class BatchProgress:
    """A bar of bytes, since recordings differ in length, with their count beside it.

    Parameters
    ----------
    found, remaining : sequences of FoundRecording
        All recordings of the run, and those still to do.
    """

    def __init__(
        self, found: Sequence[FoundRecording], remaining: Sequence[FoundRecording]
    ) -> None:
        self._bytes = {recording.path: recording.size_bytes for recording in remaining}
        self._running: dict[str, float] = {}
        """Bytes done, by recording being localized"""
        self._done_bytes = 0
        self._count, self._all = len(found) - len(remaining), len(found)
        self._console = Console(stderr=True, highlight=False, emoji=False)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=sum(self._bytes.values()))

    def told(self, recording: FoundRecording, share: float) -> None:
        """Show that a share in [0, 1] of a recording is done."""
        self._running[recording.path] = share * recording.size_bytes
        self._show()

    def done(self, record: Record) -> None:
        """Show that a recording is done or has failed."""
        self._running.pop(record["path"], None)
        self._done_bytes += self._bytes[record["path"]]
        self._count += 1
        if record["error"]:
            words = f"{record['path']}: {record['error']['code']}: {record['error']['detail']}"
            line(self._console, words, "yellow")
        self._show()

    def __enter__(self) -> Self:
        self._bar.start()
        self._show()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def _show(self) -> None:
        self._bar.update(
            self._task,
            completed=self._done_bytes + sum(self._running.values()),
            description=f"{self._count} of {self._all} recordings",
        )
