"""The service in processes of its own, and what they hold."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, "-m", "neuralmusic", "serve", "--port", "0")
PATIENCE_S = 60.0
"""Seconds until a service that hangs fails a test"""


@dataclass(frozen=True, slots=True)
class Footprint:
    """What all processes of a service hold together."""

    memory_mb: float
    """Anonymous memory: the machine's other programs share code and libraries"""
    processes: int
    threads: int
    files: int
    """Open files, sockets and pipes included"""
    temporary_files: int

    def __str__(self) -> str:
        return (
            f"{self.memory_mb:.0f} MB, {self.processes} processes, {self.threads} threads, "
            f"{self.files} files and sockets, {self.temporary_files} temporary files"
        )


class Served:
    """``neuralmusic serve`` on a free port, with a folder of its own for temporary files.

    Parameters
    ----------
    folder : Path
        Takes the temporary files and the log.
    settings : str
        Settings by their names in the environment, without the prefix.
    """

    def __init__(self, folder: Path, **settings: str) -> None:
        self._temporary = folder / "tmp"
        self._temporary.mkdir()
        self.log = folder / "log"
        environment = {
            **os.environ,
            "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}",
            "TMPDIR": str(self._temporary),
            "NEURALMUSIC_LOG_LEVEL": "warning",
            **{f"NEURALMUSIC_{name.upper()}": value for name, value in settings.items()},
        }
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                COMMAND, stdout=subprocess.PIPE, stderr=log, text=True, cwd=ROOT, env=environment
            )
        assert self._process.stdout is not None
        announced = re.search(r"http://\S+", self._process.stdout.readline())
        if announced is None:
            self.stop()
            raise AssertionError(f"the service did not start: {self.log.read_text()}")
        self.url = announced[0]
        parts = urlsplit(self.url)
        assert parts.hostname is not None
        assert parts.port is not None
        self.address = parts.hostname, parts.port

    @property
    def alive(self) -> bool:
        """Whether the first process runs."""
        return self._process.poll() is None

    def footprint(self) -> Footprint:
        """The footprint now."""
        pids = list(_tree(self._process.pid))
        return Footprint(
            sum(map(_memory_mb, pids)),
            len(pids),
            sum(_entries(pid, "task") for pid in pids),
            sum(_entries(pid, "fd") for pid in pids),
            sum(path.is_file() for path in self._temporary.rglob("*")),
        )

    def stop(self) -> None:
        """End it as an operator would."""
        self._process.terminate()
        self._process.communicate(timeout=PATIENCE_S)


def _tree(pid: int) -> Iterator[int]:
    """A process and all that it started; those that end meanwhile are left out."""
    yield pid
    for task in _list(Path(f"/proc/{pid}/task")):
        for child in _text(task / "children").split():
            yield from _tree(int(child))


def _memory_mb(pid: int) -> float:
    found = re.search(r"^RssAnon:\s+(\d+) kB", _text(Path(f"/proc/{pid}/status")), re.MULTILINE)
    return int(found[1]) / 1024 if found else 0.0


def _entries(pid: int, kind: str) -> int:
    return len(_list(Path(f"/proc/{pid}/{kind}")))


def _list(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
