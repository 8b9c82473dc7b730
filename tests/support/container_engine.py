"""The container engine of the tests: the one that runs, or one that is installed and started."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

ROOT = Path(__file__).parents[2]
PACKAGES = ("docker.io", "docker-compose", "debootstrap")
"""Debian's packages; without iptables, which docker.io brings, no port is published"""
START_S = 60
MOST_S = 600
"""Seconds after which a command that hangs fails"""


def docker(*words: str, stdin: bytes | None = None, merged: bool = False) -> str:
    """What a command of the engine prints, on both outputs where they are to be merged."""
    return run("docker", *words, stdin=stdin, merged=merged)


def run(
    *words: str,
    stdin: bytes | None = None,
    merged: bool = False,
    environment: dict[str, str] | None = None,
) -> str:
    """What a program prints; it fails with what the program complained of."""
    done = subprocess.run(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if merged else subprocess.PIPE,
        timeout=MOST_S,
        input=stdin,
        check=False,
        cwd=ROOT,
        env={**os.environ, **(environment or {})},
    )
    said = done.stdout.decode(errors="replace")
    complained = (done.stderr or b"").decode(errors="replace")
    assert done.returncode == 0, f"{' '.join(words)}: {complained[-3000:]}{said[-1000:]}"
    return said


def compose_command() -> tuple[str, ...] | None:
    """Compose as the engine's plugin or as the older program, or None."""
    if shutil.which("docker") and answers("docker", "compose", "version"):
        return ("docker", "compose")
    return ("docker-compose",) if shutil.which("docker-compose") else None


def answers(*words: str) -> bool:
    """Whether a command succeeds."""
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def install() -> None:
    """Install the engine from the distribution's packages, where that is possible."""
    have = shutil.which("dockerd") and compose_command() and shutil.which("debootstrap")
    if not have and os.geteuid() == 0 and shutil.which("apt-get"):
        answers("apt-get", "update", "-q")
        answers("apt-get", "install", "-q", "-y", "--no-install-recommends", *PACKAGES)


@contextmanager
def engine() -> Iterator[str | None]:
    """Gives None once an engine runs, else a sentence on why there is none.

    One that ran before keeps running; one that was started here is ended.
    """
    if not answers("docker", "info"):
        install()
    if answers("docker", "info"):
        yield None if compose_command() else "there is no docker compose"
        return
    if os.geteuid() != 0:
        yield "no container engine runs, and only root could start one"
        return
    if not shutil.which("dockerd"):
        yield "no container engine is installed, and none could be"
        return
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            ["dockerd", "--data-root", str(data_root())], stdout=log, stderr=log
        )
        try:
            yield None if comes_up(process) else f"dockerd does not start: {last_line(log)}"
        finally:
            process.terminate()
            process.wait(START_S)


def data_root() -> Path:
    """Folder in which an engine started here keeps its images from run to run."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "neuralmusic" / "docker"


def comes_up(process: subprocess.Popen[bytes]) -> bool:
    """Whether the engine answers before it ends or the time is over."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        if answers("docker", "info"):
            return compose_command() is not None
    return False


def last_line(log: IO[bytes]) -> str:
    log.seek(0)
    return log.read().decode(errors="replace").strip().rpartition("\n")[2]
