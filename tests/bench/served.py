"""``neuralmusic serve`` as a process of its own, and what it and its workers take."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx2

ROOT = Path(__file__).parents[2]
COMMAND = Path(sys.executable).with_name("neuralmusic")
START_S = 60.0
END_S = 30.0
MARK = " serves on "


@dataclass(frozen=True, slots=True)
class Footprint:
    """Resources of the service and its workers together, or of the service alone."""

    processes: int
    pss_mb: float
    """Memory with shared pages divided among their processes, so that it adds up"""
    heap_mb: float
    """Memory that the service's own process allocated"""
    threads: int
    files: int
    """Open files, sockets included"""
    sockets: int

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


class Served:
    """A running service; the standard error of it and its workers is kept in ``log``.

    Parameters
    ----------
    *flags : str
        Flags of ``neuralmusic serve``; the port is free unless it is given.
    environment : mapping, optional
        Further variables.
    within : sequence of str
        A command that runs the service, such as ``ip netns exec NAME``.
    """

    def __init__(
        self,
        *flags: str,
        environment: Mapping[str, str] | None = None,
        within: Sequence[str] = (),
    ) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        port = () if "--port" in flags else ("--port", "0")
        self.process = subprocess.Popen(
            [*within, COMMAND, "serve", *port, "--log-level", "warning", *flags],
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}", **(environment or {})},
            text=True,
        )
        self.pid = self.process.pid
        announced: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, args=(announced,), daemon=True).start()
        line = announced.get(timeout=START_S)
        if MARK not in line:
            self.process.wait(END_S)
            with self._log:
                raise RuntimeError(f"the service did not start: {line}{self.log}")
        self.url = line.partition(MARK)[2].strip()
        self.port = int(self.url.rpartition(":")[2])

    def _read(self, announced: queue.Queue[str]) -> None:
        assert self.process.stdout is not None
        with self.process.stdout:
            for line in self.process.stdout:
                announced.put(line)
        announced.put("")

    @property
    def log(self) -> str:
        """What was written to the standard error so far."""
        size = os.fstat(self._log.fileno()).st_size
        return os.pread(self._log.fileno(), size, 0).decode(errors="replace")

    def workers(self, kind: str = "worker") -> list[int]:
        """Process ids of the children whose command line names this kind of worker."""
        return [pid for pid in children(self.pid) if kind in command_line(pid)]

    def footprint(self, *, workers: bool = True) -> Footprint:
        """What the service takes now, with its workers or alone."""
        pids = [self.pid, *(children(self.pid) if workers else ())]
        targets = [target for pid in pids for target in open_files(pid)]
        return Footprint(
            processes=len(pids),
            pss_mb=round(sum(map(pss_mb, pids)), 2),
            heap_mb=round(heap_mb(self.pid), 2),
            threads=sum(map(threads, pids)),
            files=len(targets),
            sockets=sum(target.startswith("socket:") for target in targets),
        )

    def running_sessions(self) -> int:
        """How many streams run, as the service says."""
        return sum(each["state"] == "running" for each in self.get("/sessions")["sessions"])

    def get(self, path: str) -> Any:
        """The JSON of a path."""
        return httpx2.get(f"{self.url}{path}", timeout=END_S).json()

    def stop(self) -> int:
        """End it as an operator does; the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.stop()
        finally:
            if exc is not None:
                sys.stderr.write(self.log)
            self._log.close()


def children(pid: int) -> list[int]:
    """The processes that a process started, whichever of its threads did."""
    found: list[int] = []
    for task in _listed(f"/proc/{pid}/task"):
        with suppress(OSError):
            found += map(int, Path(f"/proc/{pid}/task/{task}/children").read_text().split())
    return found


def command_line(pid: int) -> str:
    """Command line of a process, empty once it has ended."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return ""


def cpu_s(pid: int) -> float:
    """Seconds that a process and its children that ended have computed so far."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def pss_mb(pid: int) -> float:
    """Proportional set size of a process in MB, 0 once it ended."""
    return _kilobytes(f"/proc/{pid}/smaps_rollup", "Pss:") / 1024


def heap_mb(pid: int) -> float:
    """Anonymous memory of a process in MB: what it allocated, whoever shares the libraries."""
    return _kilobytes(f"/proc/{pid}/status", "RssAnon:") / 1024


def threads(pid: int) -> int:
    """Number of threads of a process."""
    return len(_listed(f"/proc/{pid}/task"))


def open_files(pid: int) -> Iterator[str]:
    """What the file descriptors of a process point at."""
    for number in _listed(f"/proc/{pid}/fd"):
        with suppress(OSError):
            yield os.readlink(f"/proc/{pid}/fd/{number}")


def _listed(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:  # it ended
        return []


def _kilobytes(path: str, name: str) -> int:
    with suppress(OSError):
        for line in Path(path).read_text().splitlines():
            if line.startswith(name):
                return int(line.split()[1])
    return 0
