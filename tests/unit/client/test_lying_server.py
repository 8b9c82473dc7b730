"""Servers that lie, drip and never end: one error of the client, in time, in little memory."""

from __future__ import annotations

import asyncio
import gzip
import json
import logging
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
import websockets

from neuralmusic import (
    AsyncLocalizationClient,
    AsyncStreamClient,
    ClientError,
    InvalidAnswer,
    LocalizationClient,
    ServiceProblem,
    ServiceUnreachable,
    StreamClosed,
    Timeouts,
)
from neuralmusic.recordings.http import MOST_ANSWER_BYTES
from neuralmusic.streams.incoming import MOST_UNKNOWN

TIMEOUT_S = 0.4
SLACK_S = 2.0
"""Seconds that a loaded machine may add"""
Answer = Callable[[socket.socket], None]


@contextmanager
def serving(answer: Answer) -> Iterator[str]:
    """A TCP server that reads one request and then does what it likes; its address."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    with connection, suppress(OSError):
                        while b"\r\n\r\n" not in connection.recv(65536):
                            pass
                        answer(connection)

        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


def whole(status: str, body: bytes, *headers: str) -> Answer:
    head = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", "Connection: close", *headers]
    data = "\r\n".join(head).encode("latin-1") + b"\r\n\r\n" + body
    return lambda connection: connection.sendall(data)


def dripping(first: bytes, drop: bytes) -> Answer:
    """A first part, then a drop every tenth of a second, until the client goes."""

    def answer(connection: socket.socket) -> None:
        connection.sendall(first)
        connection.settimeout(0.1)
        while True:
            connection.sendall(drop)
            try:
                if not connection.recv(1024):
                    return
            except TimeoutError:
                continue

    return answer


def endless(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n")
    while True:
        connection.sendall(bytes(2**20))


def packed() -> bytes:
    return gzip.compress(bytes(300 * 2**20), 1)


LIES: dict[str, tuple[Answer, type[ClientError], str]] = {
    "a list": (whole("200 OK", b"[1]"), InvalidAnswer, "check the address"),
    "null": (whole("200 OK", b'{"models":null}'), InvalidAnswer, "check the address"),
    "no text": (whole("200 OK", b"\xff\xfe\x00garbage"), InvalidAnswer, "check the address"),
    "depth": (whole("200 OK", b"[" * 200_000), InvalidAnswer, "check the address"),
    "NaN": (whole("200 OK", b'{"models":[NaN]}'), InvalidAnswer, "check the address"),
    "deep refusal": (whole("503 x", b"[" * 200_000), ServiceProblem, "status 503"),
    "page": (whole("401 x", b"<html>"), ServiceProblem, "status 401"),
    "redirect": (whole("307 x", b"", "Location: http://127.0.0.1:1/"), ServiceProblem, "307"),
    "odd status": (whole("999 x", b"x"), ServiceProblem, "status 999"),
    "superscript": (whole("503 x", b"{}", "Retry-After: \u00b2"), ServiceProblem, "503"),
    "eternity": (whole("503 x", b"{}", "Retry-After: " + "9" * 400), ServiceProblem, "503"),
    "gzip": (
        whole("200 OK", packed(), "Content-Encoding: gzip"), InvalidAnswer, "was not asked for",
    ),
    "no end": (endless, InvalidAnswer, "larger than 128 MiB"),
    "dripping head": (dripping(b"HTTP/1.1 200 OK\r\nX: ", b"x"), ServiceUnreachable, "in time"),
    "dripping body": (
        dripping(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n", b"x"),
        ServiceUnreachable,
        "in time",
    ),
    "silence": (dripping(b"", b""), ServiceUnreachable, "in time"),
    "no HTTP": (lambda c: c.sendall(b"SSH-2.0-x\r\n"), ServiceUnreachable, "nothing answers"),
}  # fmt: skip


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_over_http_is_one_error_in_time_and_in_little_memory(lie: str) -> None:
    answer, kind, words = LIES[lie]
    with serving(answer) as url, LocalizationClient(url, timeout_s=TIMEOUT_S) as client:
        before, began = peak_mb(), time.monotonic()
        if lie == "no end":
            client._http._timeout_s = 30.0  # type: ignore[attr-defined]  # as fast as it comes
        with pytest.raises(ClientError, match=words) as caught:
            client.models()
        assert type(caught.value) is kind
        if lie != "no end":
            assert time.monotonic() - began < TIMEOUT_S + SLACK_S
        assert peak_mb() - before < 3 * MOST_ANSWER_BYTES / 2**20
        if isinstance(caught.value, ServiceProblem):
            wait = caught.value.retry_after_s
            assert wait is None or 0 <= wait <= 3600


def test_an_upload_that_is_not_read_ends_in_time() -> None:
    async def ask(url: str) -> None:
        async with AsyncLocalizationClient(url, timeout_s=TIMEOUT_S) as client:
            await client.localize(bytes(64 * 2**20), array="square")

    with serving(dripping(b"", b"")) as url, pytest.raises(ServiceUnreachable, match="in time"):
        asyncio.run(ask(url))


READY = {
    "seq": 0, "type": "ready", "session": "s", "model": None, "method": "music",
    "array": {"name": "x", "positions_m": [[0, 0, 0], [0.1, 0, 0]]}, "channel_map": [0, 1],
    "convention": "", "noise": None,
    "timing": {
        "interval_ms": 100, "window_ms": 500.0, "algorithmic_latency_ms": 80.0,
        "sample_rate": 16000,
    },
    "limits": {
        "max_message_bytes": 65536, "buffer_ms": 600, "idle_timeout_s": 0.3,
        "max_session_s": 86400.0,
    },
}  # fmt: skip
Speaker = Callable[[Any], Any]


async def garbage(socket: Any) -> None:
    while True:
        await socket.send("garbage{")
        await asyncio.sleep(0)  # the client shares the loop


async def nothing(socket: Any) -> None:
    await socket.wait_closed()


async def half_ready(socket: Any) -> None:
    await socket.send(json.dumps({**READY, "limits": {}}))
    await socket.wait_closed()


async def deep(socket: Any) -> None:
    await socket.send("[" * 200_000)
    await socket.wait_closed()


async def huge(socket: Any) -> None:
    await socket.send("x" * 2**22)


async def garbage_later(socket: Any) -> None:
    await socket.send(json.dumps(READY))
    await garbage(socket)


async def hear(stream: AsyncStreamClient) -> None:
    async with stream:
        async for _ in stream:
            pass


@pytest.mark.parametrize(
    ("speaker", "kind", "words"),
    [
        (garbage, InvalidAnswer, "none of this service's"),
        (nothing, ServiceUnreachable, "did not answer `start`"),
        (half_ready, ServiceUnreachable, "did not answer `start`"),
        (deep, ServiceUnreachable, "did not answer `start`"),
        (huge, ServiceProblem, "without a word"),
        (garbage_later, InvalidAnswer, "none of this service's"),
    ],
)
def test_a_lie_over_a_socket_is_one_error_in_time(
    speaker: Speaker, kind: type[ClientError], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="neuralmusic.client")

    async def use() -> None:
        async def speak(connection: Any) -> None:
            await connection.recv()
            with suppress(websockets.ConnectionClosed):
                await speaker(connection)

        serve = websockets.serve(speak, "127.0.0.1", 0, subprotocols=["doa.v1"])  # type: ignore[list-item]
        async with serve as server:
            port = next(iter(server.sockets)).getsockname()[1]
            stream = AsyncStreamClient(
                f"http://127.0.0.1:{port}",
                audio={"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 2},
                array={"positions_m": [[0, 0, 0], [0.1, 0, 0]]},
                timeouts=Timeouts(open_s=TIMEOUT_S),
            )
            began = time.monotonic()
            with pytest.raises(ClientError, match=words) as caught:
                await hear(stream)
            assert isinstance(caught.value, kind)
            assert time.monotonic() - began < TIMEOUT_S + SLACK_S

    asyncio.run(use())
    assert len(caplog.records) <= min(4, MOST_UNKNOWN)


def test_a_pause_of_the_audio_is_bridged_by_pings() -> None:
    async def use() -> list[str]:
        pinged: list[str] = []

        async def speak(connection: Any) -> None:
            await connection.recv()
            await connection.send(json.dumps(READY))
            for _ in range(3):
                pinged.append(json.loads(await connection.recv())["type"])
            await connection.close(1008)

        async with websockets.serve(speak, "127.0.0.1", 0, subprotocols=["doa.v1"]) as server:  # type: ignore[list-item]
            port = next(iter(server.sockets)).getsockname()[1]
            stream = AsyncStreamClient(
                f"http://127.0.0.1:{port}",
                audio={"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 2},
                array={"positions_m": [[0, 0, 0], [0.1, 0, 0]]},
            )
            with pytest.raises(StreamClosed):
                await hear(stream)
        return pinged

    assert asyncio.run(use()) == ["ping"] * 3
