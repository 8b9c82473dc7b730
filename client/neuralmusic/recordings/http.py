"""HTTP through httpx; no other module knows the library.

To replace it, change this module, whose ``Http`` and ``AsyncHttp`` are all that the clients use,
and the extra ``http`` of ``client/pyproject.toml``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, BinaryIO

import httpx

from neuralmusic.client_errors import ServiceUnreachable
from neuralmusic.recordings.answer import Answered

CONNECT_TIMEOUT_S = 10.0


class Http:
    """Requests to one service over persistent connections.

    Parameters
    ----------
    url : str
        ``http(s)://host[:port][/prefix]``.
    headers : dict
        Headers of every request.
    timeout_s : float
        Seconds without any byte of an answer after which a request is given up.
    transport : optional
        httpx's, for tests.
    """

    def __init__(self, url: str, headers: dict[str, str], timeout_s: float, transport: Any) -> None:
        self._url = url
        self._client = httpx.Client(**_settings(url, headers, timeout_s), transport=transport)

    def get(self, path: str) -> Answered:
        """Get a document; ServiceUnreachable where nothing answers."""
        with _reaching(self._url):
            return _answered(self._client.get(path))

    def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording; ServiceUnreachable where nothing answers."""
        with _reaching(self._url):
            return _answered(self._client.post(path, **_form(fields, audio)))

    def close(self) -> None:
        """Close the connections."""
        self._client.close()


class AsyncHttp:
    """``Http`` for asyncio."""

    def __init__(self, url: str, headers: dict[str, str], timeout_s: float, transport: Any) -> None:
        self._url = url
        self._client = httpx.AsyncClient(**_settings(url, headers, timeout_s), transport=transport)

    async def get(self, path: str) -> Answered:
        """Get a document; ServiceUnreachable where nothing answers."""
        with _reaching(self._url):
            return _answered(await self._client.get(path))

    async def post(self, path: str, fields: dict[str, str], audio: BinaryIO) -> Answered:
        """Send a form with a recording; ServiceUnreachable where nothing answers."""
        with _reaching(self._url):
            return _answered(await self._client.post(path, **_form(fields, audio)))

    async def close(self) -> None:
        """Close the connections."""
        await self._client.aclose()


def _settings(url: str, headers: dict[str, str], timeout_s: float) -> dict[str, Any]:
    timeout = httpx.Timeout(timeout_s, connect=CONNECT_TIMEOUT_S)
    return {"base_url": url, "headers": headers, "timeout": timeout}


def _form(fields: dict[str, str], audio: BinaryIO) -> dict[str, Any]:
    return {"data": fields, "files": {"audio": ("recording", audio, "application/octet-stream")}}


def _answered(response: httpx.Response) -> Answered:
    return Answered(
        str(response.request.url),
        response.status_code,
        response.reason_phrase,
        response.content,
        response.headers.get("Retry-After"),
    )


@contextlib.contextmanager
def _reaching(url: str) -> Iterator[None]:
    """Turn network errors into ServiceUnreachable."""
    try:
        yield
    except httpx.TimeoutException:
        raise ServiceUnreachable(f"{url} did not answer in time") from None
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise ServiceUnreachable.at(url, error, str(error)) from None
