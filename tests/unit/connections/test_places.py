"""Connections are bounded in all and per address; those that do nothing make room."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_network

import pytest

from service.connections.allowance import Allowance
from service.connections.places import FILES_KEPT, FILES_PER_CONNECTION, Places
from service.settings import Settings


@dataclass(eq=False)
class Guest:
    """A connection that remembers whether it was closed."""

    address: str
    idle: bool = True
    left: bool = False

    def leave(self) -> None:
        self.left = True


def test_the_oldest_idle_connection_makes_room() -> None:
    places = Places(most=3, most_per_address=3)
    stream, old, new = Guest("192.0.2.1", idle=False), Guest("192.0.2.2"), Guest("192.0.2.3")
    assert all(map(places.enter, (stream, old, new)))
    assert places.enter(Guest("192.0.2.4"))
    assert [guest.left for guest in (stream, old, new)] == [False, True, False]


def test_an_address_makes_room_among_its_own() -> None:
    places = Places(most=9, most_per_address=2)
    other, first, second = Guest("192.0.2.1"), Guest("192.0.2.2"), Guest("192.0.2.2")
    assert all(map(places.enter, (other, first, second, Guest("192.0.2.2"))))
    assert [guest.left for guest in (other, first, second)] == [False, True, False]


def test_a_new_connection_is_refused_where_all_are_busy() -> None:
    places = Places(most=9, most_per_address=1)
    busy = Guest("192.0.2.1", idle=False)
    assert places.enter(busy)
    refused = Guest("192.0.2.1")
    assert not places.enter(refused)
    places.leave(refused)
    assert places.enter(Guest("192.0.2.2"))
    places.leave(busy)
    assert places.enter(Guest("192.0.2.1"))


@pytest.mark.parametrize(
    ("addresses", "fits"),
    [
        (("2001:db8::1", "2001:db8::2:1"), False),
        (("2001:db8::1", "2001:db8:0:1::1"), True),
        (("::ffff:192.0.2.1", "::ffff:192.0.2.2"), True),
        (("::ffff:192.0.2.1", "192.0.2.1"), False),
        (("10.0.0.1", "10.0.0.1"), True),
        (("", ""), True),
    ],
    ids=["one network", "two networks", "mapped", "mapped and not", "a proxy", "a Unix socket"],
)
def test_what_counts_as_one_address(addresses: tuple[str, str], fits: bool) -> None:
    places = Places(9, most_per_address=1, proxies=[ip_network("10.0.0.0/8")])
    assert places.enter(Guest(addresses[0], idle=False))
    assert places.enter(Guest(addresses[1], idle=False)) is fits


def test_connections_and_their_uploads_leave_files_for_the_rest() -> None:
    settings = Settings(workers=2, stream_workers=2)
    places = Places.of(settings, files=1024)
    assert places.most * FILES_PER_CONNECTION + FILES_KEPT < 1024
    assert places.most_per_address == places.most // 2
    assert Places.of(settings, files=2**20).most == settings.max_connections


def test_an_allowance_is_a_rate_with_a_burst() -> None:
    allowance = Allowance(per_s=10, burst=20, now=0.0)
    allowance.spend(20, now=0.0)
    assert allowance.wait_s() == 0
    allowance.spend(5, now=0.0)
    assert allowance.wait_s() == 0.5
    allowance.spend(0, now=100.0)
    allowance.spend(21, now=100.0)
    assert allowance.wait_s() == pytest.approx(0.1)
