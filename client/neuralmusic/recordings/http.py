"""HTTP through httpx; no other module knows the library.

To replace it, change this module, whose ``Http`` and ``AsyncHttp`` are all that the clients use,
and the extra ``http`` of ``client/pyproject.toml``.

httpx waits for single bytes; a server that drips could hold a call for days. So every phase of a
request has a deadline here: sending goes on while the recording is read, the head of the answer
must come within ``timeout_s`` of its last byte, and the body within ``timeout_s`` of the head.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterator
from typing import Any, BinaryIO

import httpx

from neuralmusic.client_errors import InvalidAnswer, ServiceUnreachable
from neuralmusic.loop_thread import LoopThread
from neuralmusic.recordings.answer import Answered
from neuralmusic.timeout import within

CONNECT_TIMEOUT_S = 10.0
MOST_ANSWER_BYTES = 128 * 2**20
"""Largest answer that is read: three hours of windows with their spectra"""
UNPACKED = {"Accept-Encoding": "identity"}
"""A packed answer could unpack to any size"""


class Http:
    """Requests to one service over persistent connections, from any thread.

    Parameters
    ----------
    url : str
        ``http(s)://host[:port][/prefix]``.
    headers : dict
        Headers of every request.
    timeout_s : float
        Seconds for the head of an answer, and again for its body.
    transport : optional
        httpx's, for tests.
    """

    def __init__(self, url: str, headers: dict[str, str], timeout_s: float, transport: Any) -> None:
        self._http = AsyncHttp(url, headers, timeout_s, transport)
        self._thread: LoopThread | None = None

    def get(self, path: str) -> Answered:
        """Get a document; raises as ``AsyncHttp``."""
        return self._loop().run(self._http.get(path))

    def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording; raises as ``AsyncHttp``."""
        return self._loop().run(self._http.post(path, fields, audio))

    def close(self) -> None:
        """Close the connections."""
        self._loop().close(self._http.close())

    def _loop(self) -> LoopThread:
        if self._thread is None:
            self._thread = LoopThread()
        return self._thread


class AsyncHttp:
    """``Http`` for asyncio.

    Its requests raise ServiceUnreachable where nothing answers in time, and InvalidAnswer where an
    answer is packed or too large.
    """

    def __init__(self, url: str, headers: dict[str, str], timeout_s: float, transport: Any) -> None:
        self._url = url
        self._timeout_s = timeout_s
        timeout = httpx.Timeout(timeout_s, connect=min(CONNECT_TIMEOUT_S, timeout_s))
        self._client = httpx.AsyncClient(
            base_url=url, headers={**headers, **UNPACKED}, timeout=timeout, transport=transport
        )

    async def get(self, path: str) -> Answered:
        """Get a document."""
        return await self._answer(self._client.build_request("GET", path), _Upload(None))

    async def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording."""
        upload = _Upload(audio)
        file = ("recording", upload, "application/octet-stream")
        request = self._client.build_request("POST", path, data=fields, files={"audio": file})  # type: ignore[dict-item]
        return await self._answer(request, upload)

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def _answer(self, request: httpx.Request, upload: _Upload) -> Answered:
        with _reaching(self._url):
            response = await self._head(request, upload)
            try:
                body = await within(self._timeout_s, self._body(response))
            finally:
                await response.aclose()
        return Answered(
            str(request.url),
            response.status_code,
            response.reason_phrase,
            body,
            response.headers.get("Retry-After"),
        )

    async def _head(self, request: httpx.Request, upload: _Upload) -> httpx.Response:
        """The head of the answer, within the timeout of the recording's last byte."""
        task = asyncio.ensure_future(self._client.send(request, stream=True))
        try:
            while not task.done():
                left = upload.moved + self._timeout_s - time.monotonic()
                if left <= 0:
                    raise asyncio.TimeoutError
                await asyncio.wait([task], timeout=left)
            return task.result()
        finally:
            if not task.done():
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)

    async def _body(self, response: httpx.Response) -> bytes:
        packed = response.headers.get("Content-Encoding", "identity")
        if packed != "identity":
            raise InvalidAnswer(f"{self._url} answers with {packed[:40]}, which was not asked for")
        if response.is_stream_consumed:  # by the transport of a test
            return response.content
        body = bytearray()
        async for part in response.aiter_raw():
            body += part
            if len(body) > MOST_ANSWER_BYTES:
                raise InvalidAnswer(
                    f"the answer of {self._url} is larger than {MOST_ANSWER_BYTES >> 20} MiB: send "
                    "a shorter recording, a longer hop_s, or leave the spectrum out"
                )
        return bytes(body)


class _Upload:
    """A recording that knows when it was last read from."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file
        self.moved = time.monotonic()

    def read(self, size: int = -1) -> bytes:
        assert self._file is not None
        self.moved = time.monotonic()
        return self._file.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@contextlib.contextmanager
def _reaching(url: str) -> Iterator[None]:
    """Turn network errors into ServiceUnreachable."""
    try:
        yield
    except (httpx.TimeoutException, asyncio.TimeoutError):
        raise ServiceUnreachable(f"{url} did not answer in time") from None
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise ServiceUnreachable.at(url, error, str(error)) from None
