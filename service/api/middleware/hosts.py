"""Which names of the service requests may use: a defence against DNS that is bound anew.

A page of ``evil.example`` whose name suddenly resolves to 127.0.0.1 is of the same origin as the
service that listens there, for the browser; only the ``Host`` header still tells it.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

from starlette.types import Scope

from neuralmusic.errors import HostRefused


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is reached from this machine alone."""
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
        Of the connection; ``server`` is the address at which it arrived.
    header : str
        ``Host``; programs that send none are no browsers.
    allowed : sequence of str
        Names, without ports; where there are none, a connection that arrived on loopback must
        name this machine or an address, and others may name anything.
    """
    host = host_name(header)
    if not host or "*" in allowed or host in allowed or (not allowed and not _arrived_here(scope)):
        return
    # An address as the host means that no name was resolved.
    if is_local_name(host) or _is_address(host):
        return
    raise HostRefused(
        f"{host[:100]!r} is no name of this service: use its address, or add the name to "
        "NEURALMUSIC_HOSTS"
    )


def host_name(header: str) -> str:
    """The name or address of a ``Host`` header, without the port."""
    text = header.strip().lower()
    if text.startswith("["):
        return text[1:].partition("]")[0]
    return text.partition(":")[0].removesuffix(".")


def is_local_name(host: str) -> bool:
    """Names that nobody can register: ``localhost`` (RFC 6761), and names without a dot, by which
    machines call themselves."""
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
