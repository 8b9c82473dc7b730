"""The connections of one service: bounded in all and per address, idle ones make room."""

from __future__ import annotations

import ipaddress
import logging
from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from uvicorn.server import ServerState

from service.observability.logs import RareLine
from service.settings import IPNetwork, Settings

log = logging.getLogger(__name__)

FILES_KEPT = 32
"""File descriptors for the models, logs, listening sockets and whatever else is no connection"""
FILES_PER_CONNECTION = 2
"""Its socket and the temporary file of its upload"""
FEWEST = 8
"""Connections that are accepted however few files may be open"""


class Guest(Protocol):
    """A connection that takes a place."""

    @property
    def address(self) -> str:
        """The peer's IP address; empty for a Unix socket."""
        ...

    @property
    def idle(self) -> bool:
        """Whether no request of it is being answered and no stream runs over it."""
        ...

    def leave(self) -> None:
        """Close at once, without a word."""
        ...


class Places(ServerState):
    """What uvicorn's protocols share, and the places of their connections.

    Parameters
    ----------
    most, most_per_address : int
        Connections at a time; an IPv6 address stands for its network of 64 bits.
    proxies : sequence of networks
        Addresses without a bound of their own: many clients come from there.
    """

    stream_frames_per_s = 500.0
    stream_bytes_per_s = 32.0 * 2**20

    def __init__(self, most: int, most_per_address: int, proxies: Sequence[IPNetwork] = ()) -> None:
        super().__init__()
        self.most = most
        self.most_per_address = most_per_address
        self._proxies = proxies
        self._guests: dict[Guest, str] = {}
        """Every guest with its network, oldest first"""
        self._count: Counter[str] = Counter()
        self._told = RareLine(log)

    @classmethod
    def of(cls, settings: Settings, files: int) -> Places:
        """The places of a service that may have so many files open."""
        kept = FILES_KEPT + settings.workers + settings.stream_workers
        most = max(FEWEST, min(settings.max_connections, (files - kept) // FILES_PER_CONNECTION))
        most_per_address = min(settings.max_connections_per_address, max(FEWEST, most // 2))
        places = cls(most, most_per_address, settings.proxies)
        places.stream_frames_per_s = settings.stream_frames_per_s
        places.stream_bytes_per_s = settings.stream_bytes_per_s
        return places

    def enter(self, guest: Guest) -> bool:
        """Take a place, if need be that of the oldest idle guest; False where there is none."""
        network = self._network(guest.address)
        self._guests[guest] = network
        self._count[network] += 1
        crowded = bool(network) and self._count[network] > self.most_per_address
        fits = not crowded or self._dismiss(network, but=guest)
        if fits and len(self._guests) > self.most:
            fits = self._dismiss(None, but=guest)
        if not fits or crowded:
            self._told.warning(
                "%d connections, %d of %s: idle ones are closed, others refused",
                len(self._guests),
                self._count[network],
                network,
            )
        return fits

    def leave(self, guest: Guest) -> None:
        """Give the place back."""
        network = self._guests.pop(guest, None)
        if network is not None:
            self._count[network] -= 1
            if not self._count[network]:
                del self._count[network]

    def make_room(self) -> None:
        """Close the oldest idle connection, of whatever address."""
        self._dismiss(None, but=None)

    def _dismiss(self, network: str | None, but: Guest | None) -> bool:
        """Close the oldest idle connection, of this network or of all; whether there was one."""
        for guest, of in self._guests.items():
            if guest is not but and network in (None, of) and guest.idle:
                self.leave(guest)
                guest.leave()
                return True
        return False

    def _network(self, address: str) -> str:
        """What is counted as one address; empty where there is no bound."""
        try:
            ip = ipaddress.ip_address(address)
        except ValueError:  # a Unix socket
            return ""
        ip = getattr(ip, "ipv4_mapped", None) or ip
        if any(ip in proxy for proxy in self._proxies):
            return ""
        return str(ip if ip.version == 4 else ipaddress.ip_network((ip, 64), strict=False))
