"""Recordings over HTTP: ``POST /localize`` and what the service offers.

Requests go through httpx2, httpx' successor under the same authors, which starlette's test client
uses as well, so the project has one HTTP library. Answers are the documented JSON as plain
dictionaries: ``openapi.yaml`` stays their only schema, and a newer service's fields are not lost.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Self

import httpx2

from service.client.addresses import authorization, service_url
from service.client.errors import ServiceProblem, ServiceUnreachable
from service.client.start import plain
from service.errors import InvalidOption

Recording = str | Path | bytes | BinaryIO
Answer = dict[str, Any]

TIMEOUT_S = 300.0
"""Seconds that a long recording may take"""
CONNECT_TIMEOUT_S = 10.0


class LocalizationClient:
    """A client for recordings; a context manager that keeps its connections.

    Parameters
    ----------
    url : str
        ``http://robot:8000``.
    key : str, optional
        The service's key.
    timeout_s : float
        Seconds without any byte of an answer after which a request is given up.
    transport : optional
        httpx2's, for tests.
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = TIMEOUT_S,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self._url = service_url(url)
        self._http = httpx2.Client(**_settings(self._url, key, timeout_s), transport=transport)

    def localize(self, recording: Recording, *, array: Any, **options: Any) -> Answer:
        """Directions of arrival in a recording.

        Parameters
        ----------
        recording : path, bytes or binary file
            WAV, FLAC or another file that the service's libsndfile reads.
        array : str, mapping or sequence
            A preset's name, a geometry (``{"positions_m": [[x, y, z], ...]}``), or its positions
            alone, (N, 3) in metres.
        **options
            ``channel_map``, ``method``, ``model``, ``num_sources``, ``max_sources``, ``window_s``,
            ``hop_s``, ``yaw_deg``, ``exclude_deg`` (pairs of degrees), ``noise``, ``spectrum``;
            None is not sent.

        Returns
        -------
        answer : dict
            As ``POST /localize`` is documented: ``answer["summary"]["sources"]``,
            ``answer["windows"]``, ``answer["warnings"]``.

        Raises
        ------
        ServiceProblem
            If the service refuses it; ``code`` says why.
        ServiceUnreachable
            If nothing answers.
        """
        with _upload(recording) as file, _reaching(self._url):
            response = self._http.post("/localize", **_form(file, array, options))
        return _answer(response)

    def models(self) -> list[Answer]:
        """The loaded models."""
        return self._list("models")

    def arrays(self) -> list[Answer]:
        """The array presets with their positions."""
        return self._list("arrays")

    def sessions(self) -> list[Answer]:
        """The running streams."""
        return self._list("sessions")

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _list(self, name: str) -> list[Answer]:
        with _reaching(self._url):
            response = self._http.get(f"/{name}")
        return _listed(response, name)


class AsyncLocalizationClient:
    """``LocalizationClient`` for asyncio; the same arguments, answers and errors."""

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = TIMEOUT_S,
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        self._url = service_url(url)
        self._http = httpx2.AsyncClient(**_settings(self._url, key, timeout_s), transport=transport)

    async def localize(self, recording: Recording, *, array: Any, **options: Any) -> Answer:
        """Directions of arrival in a recording, as ``LocalizationClient.localize``."""
        with _upload(recording) as file, _reaching(self._url):
            response = await self._http.post("/localize", **_form(file, array, options))
        return _answer(response)

    async def models(self) -> list[Answer]:
        """The loaded models."""
        return await self._list("models")

    async def arrays(self) -> list[Answer]:
        """The array presets with their positions."""
        return await self._list("arrays")

    async def sessions(self) -> list[Answer]:
        """The running streams."""
        return await self._list("sessions")

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _list(self, name: str) -> list[Answer]:
        with _reaching(self._url):
            response = await self._http.get(f"/{name}")
        return _listed(response, name)


def _settings(url: str, key: str | None, timeout_s: float) -> dict[str, Any]:
    return {
        "base_url": url,
        "headers": authorization(key),
        "timeout": httpx2.Timeout(timeout_s, connect=CONNECT_TIMEOUT_S),
    }


@contextmanager
def _upload(recording: Recording) -> Iterator[BinaryIO]:
    """The recording as a file; a path is opened and closed here."""
    if isinstance(recording, str | Path):
        with Path(recording).open("rb") as file:
            yield file
    elif isinstance(recording, bytes | bytearray | memoryview):
        yield BytesIO(recording)
    else:
        yield recording


def _form(file: BinaryIO, array: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """The multipart form of ``POST /localize``."""
    if not isinstance(array, str | Mapping):
        array = {"positions_m": array}
    given = {"array": array, **options}
    sectors = given.get("exclude_deg")
    if sectors is not None and not isinstance(sectors, str):
        given["exclude_deg"] = ",".join(f"{first}:{last}" for first, last in sectors)
    fields = {name: _text(value) for name, value in given.items() if value is not None}
    return {"data": fields, "files": {"audio": ("recording", file, "application/octet-stream")}}


def _text(value: Any) -> str:
    """An option as the form has it; what is no text is JSON."""
    return value if isinstance(value, str) else json.dumps(value, default=plain)


@contextmanager
def _reaching(url: str) -> Iterator[None]:
    """Network errors as a sentence."""
    try:
        yield
    except httpx2.TimeoutException:
        raise ServiceUnreachable(f"{url} did not answer in time") from None
    except (httpx2.TransportError, httpx2.InvalidURL) as error:
        raise ServiceUnreachable(
            f"nothing answers at {url} ({error}): is the service running there (neuralmusic serve)?"
        ) from None


def _answer(response: httpx2.Response, key: str = "windows") -> Answer:
    """The JSON of an answer, which has this key, or the problem that it is."""
    if not response.is_success:
        raise ServiceProblem.answered(
            response.status_code,
            response.reason_phrase,
            response.content,
            response.headers.get("Retry-After"),
        )
    try:
        document = response.json()
    except ValueError:
        document = None
    if not (isinstance(document, dict) and key in document):
        raise InvalidOption(
            f"{response.request.url} answers, but not as this service does: check the address"
        )
    return document


def _listed(response: httpx2.Response, name: str) -> list[Answer]:
    found: list[Answer] = _answer(response, name)[name]
    return found
