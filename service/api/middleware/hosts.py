"""Names by which requests may address the service: a defence against DNS rebinding.

When ``evil.example`` suddenly resolves to 127.0.0.1, the browser takes its page and the service
that listens there for one origin; only the ``Host`` header still tells them apart.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

from starlette.types import Scope

from neuralmusic.errors import HostRefused


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is reachable from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_host(scope: Scope, header: str, allowed: Sequence[str]) -> None:
    """Raise HostRefused unless the ``Host`` header names this service.

    Parameters
    ----------
    scope : Scope
        The connection's; ``server`` is the address at which it arrived.
    header : str
        The ``Host`` header; a program that sends none is not a browser.
    allowed : sequence of str
        Names without ports. Where the list is empty, a connection on loopback must name this
        machine or an address, and other connections may name anything.
    """
    host = host_name(header)
    if not host or "*" in allowed or host in allowed or (not allowed and not _arrived_here(scope)):
        return
    # An address as the host means that the browser resolved no name.
    if is_local_name(host) or _is_address(host):
        return
    raise HostRefused(
        f"{host[:100]!r} is not a name of this service: use its address, or add the name to "
        "NEURALMUSIC_HOSTS"
    )


def host_name(header: str) -> str:
    """The name or address of a ``Host`` header, without the port."""
    text = header.strip().lower()
    if text.startswith("["):
        return text[1:].partition("]")[0]
    return text.partition(":")[0].removesuffix(".")


def is_local_name(host: str) -> bool:
    """Whether nobody can register the name: ``localhost`` (RFC 6761), or a name without a dot, as
    machines have on their own network."""
    return "." not in host or host.endswith(".localhost")


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _arrived_here(scope: Scope) -> bool:
    server = scope.get("server")
    return server is not None and is_loopback(str(server[0]))
