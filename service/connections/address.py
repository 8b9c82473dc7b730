"""The address that the service listens on."""

from __future__ import annotations

import errno
import socket
from contextlib import suppress

from neuralmusic.errors import ConfigError


def check_address(host: str, port: int) -> None:
    """Raise ConfigError unless the service may listen there; it does not yet."""
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise ConfigError(f"host {host} is no address of this machine: {error.strerror}") from None
    for family, kind, protocol, _, place in places:
        with suppress(OSError), socket.socket(family, kind, protocol) as probe:
            # As asyncio binds it later.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            try:
                probe.bind(place)
            except OSError as error:
                if error.errno in (errno.EADDRINUSE, errno.EACCES):
                    raise ConfigError(
                        f"nothing can listen on port {port} of {place[0]} ({error.strerror}): end "
                        "what does, or take another with --port or NEURALMUSIC_PORT"
                    ) from None
