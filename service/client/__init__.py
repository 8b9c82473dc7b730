"""The client: recordings over HTTP, and streams that reconnect, for robots.

It imports only ``service.protocol``, ``service.errors``, pydantic, websockets and, for recordings,
httpx2, so it runs where there is neither numpy nor onnxruntime nor a web server. Install it with
``pip install "neuralmusic[client]"``.
"""

import typing

from service.client.async_stream import AsyncStreamClient
from service.client.backoff import Backoff
from service.client.connection import Timeouts
from service.client.errors import (
    ClientError,
    ServiceProblem,
    ServiceUnreachable,
    StreamClosed,
    StreamRefused,
)
from service.client.inbox import Reconnecting, StreamEvent
from service.client.stream import StreamClient

if typing.TYPE_CHECKING:
    from service.client.recordings import AsyncLocalizationClient, LocalizationClient

__all__ = [
    "AsyncLocalizationClient",
    "AsyncStreamClient",
    "Backoff",
    "ClientError",
    "LocalizationClient",
    "Reconnecting",
    "ServiceProblem",
    "ServiceUnreachable",
    "StreamClient",
    "StreamClosed",
    "StreamEvent",
    "StreamRefused",
    "Timeouts",
]


def __getattr__(name: str) -> typing.Any:
    """The clients for recordings, once they are asked for: streams do without httpx2."""
    if name in ("AsyncLocalizationClient", "LocalizationClient"):
        from service.client import recordings

        return getattr(recordings, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
