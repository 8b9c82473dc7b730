"""HAProxy before replicas of the service, as ``docker/haproxy.cfg`` has it, on loopback."""

from __future__ import annotations

import shutil
import socket
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Self

CONFIGURATION = """
global
    maxconn 4096
defaults
    mode http
    timeout connect 2s
    timeout client 60s
    timeout server 60s
    timeout tunnel 60s
    timeout http-request 10s
    retries 2
    option redispatch
frontend robots
    bind {address}
    default_backend replicas
backend replicas
    balance leastconn
    option httpchk GET /readyz
    default-server check inter 1s fall 3 rise 1 on-marked-down shutdown-sessions
{servers}
"""


def installed() -> str | None:
    """Path of HAProxy."""
    return shutil.which("haproxy")


class Proxy:
    """A running HAProxy.

    Parameters
    ----------
    ports : sequence of int
        Ports of the replicas, on loopback.
    host : str
        Address to listen on.
    within : sequence of str
        A command that runs it, such as ``ip netns exec NAME``.
    """

    def __init__(
        self, ports: Sequence[int], host: str = "127.0.0.1", within: Sequence[str] = ()
    ) -> None:
        self._folder = tempfile.TemporaryDirectory()
        port = free_port()
        servers = "\n".join(
            f"    server replica{index} 127.0.0.1:{each}" for index, each in enumerate(ports)
        )
        path = Path(self._folder.name) / "haproxy.cfg"
        path.write_text(CONFIGURATION.format(address=f"{host}:{port}", servers=servers))
        self._log = Path(self._folder.name) / "log"
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                [*within, "haproxy", "-db", "-f", path], stdout=log, stderr=log
            )
        self.url = f"http://{host}:{port}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port: int = listening.getsockname()[1]
        return port
