"""Containers of the service, alone or as the compose files start them, on free ports."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx2
from container_engine import ROOT, compose_command, docker, run

PATIENCE_S = 60.0

SAMPLE = ROOT / "examples" / "two-talkers.flac"
TALKERS_DEG = (45.0, 200.0)
"""Commands as README.md states them"""
ARRAY = "respeaker-usb-4mic-v2"


class Container:
    """A container that runs, or has ended."""

    def __init__(self, id: str) -> None:
        self.id = id

    @property
    def url(self) -> str:
        """Address at which its service is published."""
        return f"http://{docker('port', self.id, '8000').split()[0]}"

    @property
    def facts(self) -> dict[str, Any]:
        """What the engine knows of it."""
        found: dict[str, Any] = json.loads(docker("inspect", self.id))[0]
        return found

    def run(self, *words: str) -> str:
        """What a program in it prints."""
        return docker("exec", self.id, *words)

    def logs(self) -> str:
        """What it has said on both outputs."""
        return docker("logs", self.id, merged=True)

    def wait(self) -> int:
        """Wait for its end; gives the exit code."""
        return int(docker("wait", self.id))

    def stop(self) -> int:
        """SIGTERM, as on every shutdown; gives the exit code."""
        docker("stop", self.id)
        return self.wait()


class ComposeProject:
    """A context manager: up on entry, down with its volumes on exit.

    Parameters
    ----------
    name : str
        Name of containers, networks and volumes.
    files : str
        Compose files' names below ``docker/``.
    **variables
        What the files interpolate; ports that are not given are chosen by the engine.
    """

    def __init__(self, name: str, *files: str, **variables: str | Path) -> None:
        command = compose_command()
        assert command is not None
        self.name = f"neuralmusic-{name}"
        self.files = [f"docker/{file}" for file in files]
        self._words = [*command, "-p", self.name, *self.file_flags]
        ports = ("NEURALMUSIC_PORT", "TLS_PORT", "PROMETHEUS_PORT", "GRAFANA_PORT")
        self._environment = {
            **dict.fromkeys(ports, "0"),
            "TLS_HOST": "127.0.0.1",
            **{key: str(value) for key, value in variables.items()},
        }

    @property
    def file_flags(self) -> list[str]:
        return [word for file in self.files for word in ("-f", file)]

    def compose(self, *words: str) -> str:
        """What a command of Compose prints."""
        return run(*self._words, *words, environment=self._environment)

    def rolling_restart(self) -> str:
        """Replace all replicas by new ones."""
        words = ["docker/rolling-restart.sh", "-p", self.name, *self.file_flags]
        return run(*words, environment=self._environment)

    def up(self, *services: str) -> None:
        self.compose("up", "-d", *services)

    def containers(self, service: str) -> list[Container]:
        """Those of a service."""
        return [Container(id) for id in self.compose("ps", "-q", service).split()]

    def url(self, service: str, port: int, scheme: str = "http") -> str:
        """Address at which a port of a service is published."""
        address = self.compose("port", service, str(port)).strip()
        return f"{scheme}://127.0.0.1:{address.rpartition(':')[2]}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if exc is not None:
            print(self.compose("logs", "--no-color", "--tail", "100"))  # beside the failure
        self.compose("down", "-v", "-t", "1", "--remove-orphans")


def wait_for(url: str, **options: Any) -> httpx2.Response:
    """The first answer of 200 at an address; fails where none comes."""
    deadline = time.monotonic() + PATIENCE_S
    said = "nothing"
    while time.monotonic() < deadline:
        try:
            answer = httpx2.get(url, **options)
        except httpx2.TransportError as error:
            said = str(error)
            continue
        if answer.status_code == 200:
            return answer
        said = str(answer.status_code)
    raise AssertionError(f"{url} says {said} after {PATIENCE_S:g} s")
