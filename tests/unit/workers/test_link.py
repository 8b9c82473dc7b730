"""Messages between the service and its workers: whatever pieces the socket makes of them."""

from __future__ import annotations

import os
import socket
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.workers.link import Link, Unpacker, packed

MESSAGES = st.lists(st.one_of(st.binary(max_size=300), st.integers(), st.text(max_size=20)))


@given(messages=MESSAGES, cuts=st.lists(st.integers(0, 3000)))
def test_messages_come_whole_and_in_order_however_they_are_cut(
    messages: list[object], cuts: list[int]
) -> None:
    data = b"".join(map(packed, messages))
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    unpacker = Unpacker()
    found: list[object] = []
    for begin, end in pairwise(edges):
        unpacker.add(data[begin:end])
        found += unpacker.messages()
    assert found == messages


def test_messages_sent_at_once_are_received_one_by_one() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        link = Link(theirs)
        ours.sendall(packed("first") + packed("second") + packed(b"x" * 100_000))
        assert [link.receive(), link.receive(), len(link.receive())] == ["first", "second", 100_000]
        ours.close()
        with pytest.raises(EOFError):
            link.receive()


def test_a_file_comes_with_its_message(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()
    path = tmp_path / "recording"
    path.write_bytes(b"sound")
    with ours, theirs, path.open("rb") as file:
        sender, receiver = Link(ours), Link(theirs)
        sender.send("job", [file.fileno()])
        sender.send("no file")
        message, descriptor = receiver.receive_with_file()
        assert message == "job"
        assert descriptor is not None
        with os.fdopen(descriptor, "rb") as received:
            assert received.read() == b"sound"
        assert receiver.receive_with_file() == ("no file", None)
