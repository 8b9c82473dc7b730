"""An HTTP client that sends whatever bytes it is given."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Answer:
    """A response."""

    status: int
    headers: Mapping[str, str]
    """Headers by their names in lower case"""
    content: bytes


class Connection:
    """One keep-alive connection; opened anew where the server closed it."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._address = address
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def ask(self, request: bytes) -> Answer:
        """Send a request, read its answer.

        Raises
        ------
        OSError, EOFError, ValueError
            If there is none, or one that is no HTTP.
        """
        if self._writer is not None:
            try:
                return await self._exchange(request)
            except (OSError, EOFError):  # closed since the last answer, as a server may
                await self.close()
        return await self._exchange(request)

    async def _exchange(self, request: bytes) -> Answer:
        if self._writer is None:
            self._reader, self._writer = await asyncio.open_connection(*self._address)
        assert self._reader is not None
        self._writer.write(request)
        answer = await _read(self._reader)
        if answer.headers.get("connection") == "close":
            await self.close()
        return answer

    async def close(self) -> None:
        """Close it; the next request opens another."""
        if self._writer is not None:
            self._writer.transport.abort()
            self._reader = self._writer = None


def post(path: str, content_type: str, content: bytes) -> bytes:
    """The bytes of a request; without a type it has no such header."""
    kind = f"Content-Type: {content_type}\r\n" if content_type else ""
    head = (
        f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{kind}Content-Length: {len(content)}\r\n\r\n"
    )
    return head.encode("latin-1") + content


async def _read(reader: asyncio.StreamReader) -> Answer:
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    first, *lines = head.rstrip("\r\n").split("\r\n")
    version, status, _ = first.split(" ", 2)
    if version != "HTTP/1.1":
        raise ValueError(f"no HTTP: {first[:80]!r}")
    headers = {name.lower(): value.strip() for name, _, value in (x.partition(":") for x in lines)}
    content = await reader.readexactly(int(headers["content-length"]))
    return Answer(int(status), headers, content)
