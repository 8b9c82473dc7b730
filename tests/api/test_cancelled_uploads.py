"""Uploads whose client goes away, in every phase, and requests that come behind one."""

from __future__ import annotations

import io
import os
import signal
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from running_service import RunningService

from service.settings import Settings
from service.workers import recording_pool

PATIENCE = 20  # seconds until a hanging test fails
QUEUE = 4
RESET = struct.pack("ii", 1, 0)
"""``SO_LINGER`` that makes a close a reset"""
PATH = b"/localize?array=respeaker-usb-4mic-v2"
PING = b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recording_pool, "LOOK_S", 0.02)
        running = RunningService(settings=Settings(workers=1, queue=QUEUE))
        yield running
        running.stop()


def raw(audio: bytes) -> bytes:
    head = b"POST %b HTTP/1.1\r\nHost: x\r\nContent-Type: audio/wav\r\nContent-Length: %d\r\n\r\n"
    return head % (PATH, len(audio)) + audio


def form(audio: bytes) -> bytes:
    body = b'--X\r\nContent-Disposition: form-data; name="audio"; filename="a.wav"\r\n\r\n'
    body += audio + b"\r\n--X--\r\n"
    head = b"POST %b HTTP/1.1\r\nHost: x\r\nContent-Type: multipart/form-data; boundary=X\r\n"
    return head % PATH + b"Content-Length: %d\r\n\r\n" % len(body) + body


def until(condition: Callable[[], bool]) -> None:
    """Look again and again, or fail."""
    ends = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.005)


def said_to(service: RunningService, said: bytes) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", service.port), PATIENCE)
    connection.sendall(said)
    return connection


def answers(connection: socket.socket, count: int) -> bytes:
    """What is answered, until there are so many answers or the connection is closed."""
    got = b""
    while got.count(b"HTTP/1.1 ") < count or not got.endswith(b"}"):
        piece = connection.recv(65536)
        if not piece:
            break
        got += piece
    return got


@contextmanager
def standing_still(service: RunningService, audio: bytes) -> Iterator[socket.socket]:
    """The only worker stands still with an upload; the connection it came over."""
    with said_to(service, raw(audio)) as connection:
        assert answers(connection, 1).startswith(b"HTTP/1.1 200 ")  # the worker is up
        (pid,) = service.state.recording_workers.pids
        os.kill(pid, signal.SIGSTOP)
        connection.sendall(raw(audio))
        try:
            until(lambda: service.state.recording_workers.admitted == 1)
            yield connection
        finally:
            os.kill(pid, signal.SIGCONT)


def go(connection: socket.socket) -> None:
    """Vanish without a word."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
    connection.close()


def held_files() -> int:
    """Temporary files without a name that this process holds open."""
    return sum(
        "(deleted)" in os.readlink(each)
        for each in Path("/proc/self/fd").iterdir()
        if each.is_symlink()
    )


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="only Linux tells open files")
@pytest.mark.parametrize("request_of", [raw, form])
@pytest.mark.parametrize("share", [0.0005, 0.3, 1.0], ids=["head", "body", "whole"])
def test_nothing_stays_of_an_upload_whose_client_vanishes(
    service: RunningService,
    sounds: Any,
    written_log: io.StringIO,
    request_of: Callable[[bytes], bytes],
    share: float,
) -> None:
    audio = sounds.wav(seconds=8)
    whole = request_of(audio)
    before = held_files()
    connection = said_to(service, whole[: max(20, round(share * len(whole)))])
    if share == 1:
        until(lambda: service.state.recording_workers.admitted == 1)
    go(connection)
    until(lambda: not service.state.recording_workers.admitted)
    with said_to(service, raw(sounds.wav(seconds=0.2))) as connection:
        assert answers(connection, 1).startswith(b"HTTP/1.1 200 ")
    until(lambda: held_files() <= before)
    assert "Traceback" not in written_log.getvalue()


def test_who_waits_in_the_queue_and_vanishes_makes_room_at_once(
    service: RunningService, sounds: Any
) -> None:
    """While the worker is busy: a robot that gives up and tries again would fill the queue."""
    audio = sounds.wav()
    workers = service.state.recording_workers
    with standing_still(service, audio):
        for request_of in (raw, form):
            waiting = [said_to(service, request_of(audio)) for _ in range(QUEUE)]
            until(lambda: workers.admitted == 1 + QUEUE)
            with said_to(service, raw(audio)) as refused:
                assert answers(refused, 1).startswith(b"HTTP/1.1 503 ")
            for each in waiting:
                go(each)
            until(lambda: workers.admitted == 1)
    until(lambda: not workers.admitted)
    with said_to(service, raw(audio)) as connection:
        assert answers(connection, 1).startswith(b"HTTP/1.1 200 ")


def test_requests_behind_an_upload_are_answered_after_it(
    service: RunningService, sounds: Any
) -> None:
    with said_to(service, 2 * raw(sounds.wav()) + PING) as connection:
        got = answers(connection, 3)
    assert [each[:3] for each in got.split(b"HTTP/1.1 ")[1:]] == [b"200"] * 3
    assert got.index(b'"summary"') < got.index(b'{"status":"ok"}')
