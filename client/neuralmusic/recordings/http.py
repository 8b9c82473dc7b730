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
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, BinaryIO

import httpx

from neuralmusic.client_errors import InvalidAnswer, ServiceUnreachable
from neuralmusic.recordings.answer import Answered
from neuralmusic.timeout import within

CONNECT_TIMEOUT_S = 10.0
MOST_ANSWER_BYTES = 128 * 2**20
"""Largest answer that is read: three hours of windows with their spectra"""


class Http:
    """Requests to one service over persistent connections.

    Its requests raise ServiceUnreachable where nothing answers in time, and InvalidAnswer where an
    answer is packed or too large.

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
        self._url = url
        self._timeout_s = timeout_s
        self._settings = _settings(url, headers, timeout_s, transport)
        self._client = httpx.Client(**self._settings)

    def get(self, path: str) -> Answered:
        """Get a document."""
        return self._answer("GET", path, _Upload(None))

    def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording."""
        upload = _Upload(audio)
        return self._answer("POST", path, upload, data=fields, files=upload.files)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _answer(self, method: str, path: str, upload: _Upload, **form: Any) -> Answered:
        """The answer; a thread of its own asks, since a blocked socket knows no deadline."""
        found: Future[Answered] = Future()
        asking = threading.Thread(
            target=_resolve,
            args=(found, self._client, method, path, upload, form),
            name="neuralmusic-request",
            daemon=True,
        )
        with _reaching(self._url):
            asking.start()
            try:
                while True:
                    left = upload.moved + self._timeout_s - time.monotonic()
                    if left <= 0:
                        raise asyncio.TimeoutError
                    with contextlib.suppress(FutureTimeout):
                        return found.result(left)
            finally:
                if not found.done():  # its thread ends with its connection
                    self._client.close()
                    self._client = httpx.Client(**self._settings)


def _resolve(
    found: Future[Answered],
    client: httpx.Client,
    method: str,
    path: str,
    upload: _Upload,
    form: dict[str, Any],
) -> None:
    """Ask, and put the answer or what came instead of it into the future."""
    try:
        with client.stream(method, path, **form) as response:
            upload.moved = time.monotonic()
            body = _Body(response)
            if not body.whole:
                for part in response.iter_raw():
                    body.add(part)
            found.set_result(body.answered)
    except BaseException as error:
        found.set_exception(error)


class AsyncHttp:
    """``Http`` for asyncio; the same errors."""

    def __init__(self, url: str, headers: dict[str, str], timeout_s: float, transport: Any) -> None:
        self._url = url
        self._timeout_s = timeout_s
        self._client = httpx.AsyncClient(**_settings(url, headers, timeout_s, transport))

    async def get(self, path: str) -> Answered:
        """Get a document."""
        return await self._answer(self._client.build_request("GET", path), _Upload(None))

    async def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording."""
        upload = _Upload(audio)
        request = self._client.build_request("POST", path, data=fields, files=upload.files)
        return await self._answer(request, upload)

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def _answer(self, request: httpx.Request, upload: _Upload) -> Answered:
        with _reaching(self._url):
            response = await self._head(request, upload)
            try:
                body = _Body(response)
                if not body.whole:
                    await within(self._timeout_s, self._read(response, body))
            finally:
                await response.aclose()
        return body.answered

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

    async def _read(self, response: httpx.Response, body: _Body) -> None:
        async for part in response.aiter_raw():
            body.add(part)


class _Body:
    """The body of an answer as it comes, within bounds."""

    def __init__(self, response: httpx.Response) -> None:
        self._response = response
        self._url = str(response.request.url)
        packed = response.headers.get("Content-Encoding", "identity")
        if packed != "identity":
            raise InvalidAnswer(f"{self._url} answers with {packed[:40]}, which was not asked for")
        self.whole = response.is_stream_consumed
        """Whether the transport has read it already, as that of a test"""
        self._bytes = bytearray(response.content if self.whole else b"")

    def add(self, part: bytes) -> None:
        self._bytes += part
        if len(self._bytes) > MOST_ANSWER_BYTES:
            raise InvalidAnswer(
                f"the answer of {self._url} is larger than {MOST_ANSWER_BYTES >> 20} MiB: send a "
                "shorter recording, a longer hop_s, or leave the spectrum out"
            )

    @property
    def answered(self) -> Answered:
        response = self._response
        return Answered(
            self._url,
            response.status_code,
            response.reason_phrase,
            bytes(self._bytes),
            response.headers.get("Retry-After"),
        )


class _Upload:
    """A recording that is sent, and the time of the last progress of its request."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file
        self.moved = time.monotonic()
        """Monotonic time at which it was last read from, or the head of the answer came"""

    @property
    def files(self) -> dict[str, Any]:
        """The form's part, as httpx takes it."""
        return {"audio": ("recording", self, "application/octet-stream")}

    def read(self, size: int = -1) -> bytes:
        assert self._file is not None
        self.moved = time.monotonic()
        return self._file.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _settings(
    url: str, headers: dict[str, str], timeout_s: float, transport: Any
) -> dict[str, Any]:
    timeout = httpx.Timeout(timeout_s, connect=min(CONNECT_TIMEOUT_S, timeout_s))
    unpacked = {"Accept-Encoding": "identity"}  # a packed answer could unpack to any size
    headers = {**headers, **unpacked}
    return {"base_url": url, "headers": headers, "timeout": timeout, "transport": transport}


@contextlib.contextmanager
def _reaching(url: str) -> Iterator[None]:
    """Turn network errors into ServiceUnreachable."""
    try:
        yield
    except (httpx.TimeoutException, asyncio.TimeoutError):
        raise ServiceUnreachable(f"{url} did not answer in time") from None
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise ServiceUnreachable.at(url, error, str(error)) from None
