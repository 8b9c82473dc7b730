"""The client: recordings over HTTP, and streams that reconnect, for robots.

It imports only ``service.protocol``, ``service.errors``, pydantic, websockets and httpx2, so it
runs where there is neither numpy nor onnxruntime nor a web server. Install it with
``pip install "neuralmusic[client]"``.
"""

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
from service.client.recordings import AsyncLocalizationClient, LocalizationClient
from service.client.stream import StreamClient

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
