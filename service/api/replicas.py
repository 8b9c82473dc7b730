"""The replicas of a service behind one address: each is asked what it knows of sessions.

A request goes to every address that the setting ``peers`` leads to, this process's own included,
so nobody needs to know which of them is itself. HTTP/1.0 suffices: the answer ends with its
connection.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from http import HTTPStatus

from fastapi import Request

log = logging.getLogger(__name__)

PATIENCE_S = 2.0
"""Seconds in which a replica must begin to answer"""
LOOK_S = 1.0
"""Seconds between looks whether a long answer is still wanted"""
MAX_BYTES = 2**20
"""Most bytes of an answer that is read whole"""
PIECE = 2**16
FORWARDED = ("host", "authorization", "x-request-id")
"""Headers of a request that the other replicas get as well"""
ALONE = "replicas=one"
"""Query of a request that a replica answers from what it knows itself"""


@dataclass(frozen=True, slots=True)
class Reply:
    """The beginning of a replica's answer; its body is still to come."""

    status: int
    headers: dict[str, str]
    """Values by names in lower case"""
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    async def whole(self) -> bytes:
        """The body, at most ``MAX_BYTES`` of it."""
        body = bytearray()
        async with asyncio.timeout(PATIENCE_S):
            while len(body) < MAX_BYTES and (piece := await self.reader.read(PIECE)):
                body += piece
        return bytes(body)

    async def pieces(self, wanted: Callable[[], bool]) -> AsyncIterator[bytes]:
        """The body as it comes, for as long as it is wanted."""
        while wanted():
            try:
                piece = await asyncio.wait_for(self.reader.read(PIECE), LOOK_S)
            except TimeoutError:
                continue
            if not piece:
                return
            yield piece

    def close(self) -> None:
        """Give the connection up."""
        self.writer.close()


class Replicas:
    """All replicas of the service, or this one alone.

    Parameters
    ----------
    peers : sequence of (str, int)
        Names and ports; a name leads to every address it has.
    """

    def __init__(self, peers: Sequence[tuple[str, int]] = ()) -> None:
        self._peers = tuple(peers)
        self.name = f"{socket.gethostname()}-{secrets.token_hex(2)}"
        """Name of this process, which no other has"""

    @property
    def known(self) -> bool:
        """Whether other replicas can be asked."""
        return bool(self._peers)

    async def ask(self, request: Request, path: str) -> list[Reply | None]:
        """What every replica answers to GET of a path; None where it does not in time."""
        addresses = await self._addresses()
        return await asyncio.gather(*(_asked(each, request, path) for each in addresses))

    async def find(self, request: Request, path: str) -> Reply | None:
        """The answer of the replica that has what a path leads to."""
        found: Reply | None = None
        for reply in filter(None, await self.ask(request, path)):
            if found is None and reply.status != HTTPStatus.NOT_FOUND:
                found = reply
            else:
                reply.close()
        return found

    async def _addresses(self) -> set[tuple[str, int]]:
        """The addresses of all names; they change as replicas come and go."""
        loop = asyncio.get_running_loop()
        found: set[tuple[str, int]] = set()
        for host, port in self._peers:
            try:
                async with asyncio.timeout(PATIENCE_S):
                    known = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            except (OSError, TimeoutError) as error:
                log.warning("the replicas' name %s leads nowhere: %s", host, error)
            else:
                # A replica with addresses of both kinds would be asked twice.
                kind = min(family for family, *_ in known)  # IPv4, where there is any
                found |= {(str(place[0]), port) for family, *_, place in known if family == kind}
        return found


async def _asked(address: tuple[str, int], request: Request, path: str) -> Reply | None:
    headers = {name: request.headers[name] for name in FORWARDED if name in request.headers}
    lines = [f"GET {path} HTTP/1.0", *(f"{name}: {value}" for name, value in headers.items())]
    try:
        async with asyncio.timeout(PATIENCE_S):
            reader, writer = await asyncio.open_connection(*address)
            try:
                writer.write("\r\n".join([*lines, "", ""]).encode("latin-1"))
                head = await reader.readuntil(b"\r\n\r\n")
                return _read_head(head, reader, writer)
            except BaseException:
                writer.close()
                raise
    except (OSError, TimeoutError, EOFError, ValueError, asyncio.LimitOverrunError) as error:
        log.warning("the replica at %s did not answer: %r", address[0], error)
        return None


def _read_head(head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Reply:
    first, *lines = head.decode("latin-1").strip().split("\r\n")
    named = (line.partition(":") for line in lines)
    headers = {name.strip().lower(): value.strip() for name, _, value in named}
    return Reply(int(first.split()[1]), headers, reader, writer)
