"""Recordings over HTTP: ``POST /localize`` and what the service offers.

Answers are the documented JSON as plain dictionaries: ``openapi.yaml`` stays their only schema, and
a newer service's fields are not lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from typing_extensions import Self

from neuralmusic.addresses import authorization, service_url
from neuralmusic.errors import ConfigError
from neuralmusic.protocol.methods import Hemisphere, Method
from neuralmusic.recordings.answer import Answer
from neuralmusic.recordings.form import Array, Recording, Sectors, form_fields, opened

if TYPE_CHECKING:
    from neuralmusic.recordings.http import AsyncHttp, Http

TIMEOUT_S = 300.0
"""Default seconds to wait for an answer, enough for a long recording"""


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
        httpx's, for tests.

    Raises
    ------
    ConfigError
        If httpx is missing, which the extra ``http`` brings.
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = TIMEOUT_S,
        transport: Any = None,
    ) -> None:
        self._http: Http = _http().Http(service_url(url), authorization(key), timeout_s, transport)

    def localize(
        self,
        recording: Recording,
        *,
        array: Array,
        channel_map: Sequence[int] | str | None = None,
        model: str | None = None,
        method: Method | None = None,
        num_sources: int | None = None,
        max_sources: int | None = None,
        window_s: float | None = None,
        hop_s: float | None = None,
        yaw_deg: float | None = None,
        exclude_deg: Sectors | None = None,
        hemisphere: Hemisphere | None = None,
        noise: str | None = None,
        spectrum: bool | Literal["sphere"] | None = None,
    ) -> Answer:
        """Directions of arrival in a recording.

        Parameters
        ----------
        recording : path, bytes or binary file
            WAV, FLAC or another file that the service's libsndfile reads.
        array : str, mapping or sequence
            A preset's name, a geometry (``{"positions_m": [[x, y, z], ...]}``), or its positions
            alone, (N, 3) in metres.
        channel_map : sequence of int, optional
            The recording's channel of every microphone, from 0.
        model : str, optional
            A model's name; by default the first that fits the array.
        method : str, optional
            ``neural``, ``norm_music``, ``music``, ``srp_phat`` or ``gcc_phat``; by default
            ``neural`` where a model fits the array, else ``norm_music``.
        num_sources, max_sources : int, optional
            The known number of sources, or a bound on the estimated one.
        window_s, hop_s : float, optional
            Seconds of audio per result, and from one result to the next.
        yaw_deg : float, optional
            Degrees by which the array is turned on the robot, counter-clockwise.
        exclude_deg : sequence of pairs, optional
            Sectors (from, to) in degrees in which nothing is reported.
        hemisphere : str, optional
            ``upper`` or ``lower``, the side of the horizontal plane on which all sources are: a
            level array then tells elevations.
        noise : str, optional
            A stored profile of the robot's own noise.
        spectrum : bool or str, optional
            Whether every window has its spatial spectrum, 360 values; ``"sphere"`` gives an
            image of the sphere instead, 36 elevations of 72 azimuths.

        Returns
        -------
        answer : dict
            The documented answer of ``POST /localize``: ``answer["summary"]["sources"]``,
            ``answer["windows"]``, ``answer["warnings"]``.

        Raises
        ------
        ServiceProblem
            If the service refuses; ``code`` says why.
        ServiceUnreachable
            If nothing answers.
        """
        options = {
            "channel_map": channel_map,
            "model": model,
            "method": method,
            "num_sources": num_sources,
            "max_sources": max_sources,
            "window_s": window_s,
            "hop_s": hop_s,
            "yaw_deg": yaw_deg,
            "exclude_deg": exclude_deg,
            "hemisphere": hemisphere,
            "noise": noise,
            "spectrum": spectrum,
        }
        with opened(recording) as file:
            answered = self._http.post("/localize", form_fields(array, options), file)
        return answered.document("windows")

    def models(self) -> list[Answer]:
        """The loaded models."""
        return self._http.get("/models").listed("models")

    def arrays(self) -> list[Answer]:
        """The array presets with their positions."""
        return self._http.get("/arrays").listed("arrays")

    def sessions(self) -> list[Answer]:
        """The running streams."""
        return self._http.get("/sessions").listed("sessions")

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncLocalizationClient:
    """``LocalizationClient`` for asyncio; the same arguments, answers and errors."""

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout_s: float = TIMEOUT_S,
        transport: Any = None,
    ) -> None:
        self._http: AsyncHttp = _http().AsyncHttp(
            service_url(url), authorization(key), timeout_s, transport
        )

    async def localize(
        self,
        recording: Recording,
        *,
        array: Array,
        channel_map: Sequence[int] | str | None = None,
        model: str | None = None,
        method: Method | None = None,
        num_sources: int | None = None,
        max_sources: int | None = None,
        window_s: float | None = None,
        hop_s: float | None = None,
        yaw_deg: float | None = None,
        exclude_deg: Sectors | None = None,
        hemisphere: Hemisphere | None = None,
        noise: str | None = None,
        spectrum: bool | Literal["sphere"] | None = None,
    ) -> Answer:
        """Directions of arrival in a recording, as ``LocalizationClient.localize``."""
        options = {
            "channel_map": channel_map,
            "model": model,
            "method": method,
            "num_sources": num_sources,
            "max_sources": max_sources,
            "window_s": window_s,
            "hop_s": hop_s,
            "yaw_deg": yaw_deg,
            "exclude_deg": exclude_deg,
            "hemisphere": hemisphere,
            "noise": noise,
            "spectrum": spectrum,
        }
        with opened(recording) as file:
            answered = await self._http.post("/localize", form_fields(array, options), file)
        return answered.document("windows")

    async def models(self) -> list[Answer]:
        """The loaded models."""
        return (await self._http.get("/models")).listed("models")

    async def arrays(self) -> list[Answer]:
        """The array presets with their positions."""
        return (await self._http.get("/arrays")).listed("arrays")

    async def sessions(self) -> list[Answer]:
        """The running streams."""
        return (await self._http.get("/sessions")).listed("sessions")

    async def close(self) -> None:
        """Close the connections."""
        await self._http.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


def _http() -> Any:
    """The module of the HTTP library, which streams do not need."""
    try:
        from neuralmusic.recordings import http
    except ImportError:
        raise ConfigError(
            "recordings over HTTP need httpx: pip install './client[http]' in the project's folder"
        ) from None
    return http
