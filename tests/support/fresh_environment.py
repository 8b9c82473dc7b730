"""Environments of their own, on every Python that the machine has."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PROBE = "import ssl, sys, venv; print(*sys.version_info[:2], sep='.')"
LISTED = """
import json, sysconfig
from importlib.metadata import distributions
print(json.dumps([[each.metadata["Name"], sum(
    file.locate().stat().st_size for file in each.files or () if file.locate().exists()
)] for each in distributions()]))
"""


@dataclass(frozen=True)
class Environment:
    """A virtual environment of one test."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    def install(self, *what: str) -> None:
        """Install from the index that pip is set to, wheels alone."""
        done = self.pip("--only-binary=:all:", *what)
        assert done.returncode == 0, done.stderr

    def pip(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """``pip install`` of the tests' own pip: one in every environment takes its time."""
        flags = ("--disable-pip-version-check", "--python", str(self.python))
        return subprocess.run(
            [sys.executable, "-m", "pip", *flags, "install", "-q", *arguments],
            capture_output=True,
            text=True,
            check=False,
        )

    def run(self, *words: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
        """A command of the environment, away from the checkout."""
        program, *arguments = words
        return subprocess.run(
            [self.folder / "bin" / program, *arguments],
            capture_output=True,
            text=True,
            check=False,
            cwd=folder or self.folder,
            env=clean(),
        )

    def distributions(self) -> dict[str, int]:
        """What is installed, with the bytes of its files."""
        return dict(json.loads(self.run("python", "-c", LISTED).stdout))


def create(python: str, folder: Path) -> Environment:
    """A fresh environment on that Python."""
    subprocess.run([python, "-m", "venv", "--without-pip", folder], check=True, capture_output=True)
    return Environment(folder)


def clean() -> dict[str, str]:
    """The process's variables without those that lead back to the checkout."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@cache
def pythons() -> dict[str, str]:
    """Interpreters by their version, as 3.9; the first that is found."""
    found: dict[str, str] = {}
    for path in _candidates():
        done = subprocess.run([path, "-c", PROBE], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            found.setdefault(done.stdout.strip(), path)
    return found


def _candidates() -> Iterator[str]:
    for minor in range(9, 14):
        path = shutil.which(f"python3.{minor}")
        if path:
            yield path
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from map(str, sorted(root.glob("versions/3.*/bin/python")))
