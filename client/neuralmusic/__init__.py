"""Client of NeuralMUSIC Service: directions of arrival for robots.

``StreamClient`` and ``AsyncStreamClient`` stream a microphone array and reconnect;
``LocalizationClient`` and ``AsyncLocalizationClient`` send recordings over HTTP and need the extra
``http``. ``neuralmusic.protocol`` holds the messages, ``neuralmusic.errors`` every error's code.
"""

from __future__ import annotations

import importlib
import typing

if typing.TYPE_CHECKING:
    from neuralmusic.client_errors import (
        ClientError,
        InvalidAnswer,
        ServiceProblem,
        ServiceUnreachable,
        StreamClosed,
        StreamRefused,
    )
    from neuralmusic.recordings.client import AsyncLocalizationClient, LocalizationClient
    from neuralmusic.streams.async_stream import AsyncStreamClient
    from neuralmusic.streams.backoff import Backoff
    from neuralmusic.streams.connection import Timeouts
    from neuralmusic.streams.inbox import NewSession, Reconnecting, StreamEvent
    from neuralmusic.streams.stream import StreamClient

__version__ = "0.2.0"

__all__ = [
    "AsyncLocalizationClient",
    "AsyncStreamClient",
    "Backoff",
    "ClientError",
    "InvalidAnswer",
    "LocalizationClient",
    "NewSession",
    "Reconnecting",
    "ServiceProblem",
    "ServiceUnreachable",
    "StreamClient",
    "StreamClosed",
    "StreamEvent",
    "StreamRefused",
    "Timeouts",
]

_HOMES = {
    "AsyncLocalizationClient": "recordings.client",
    "AsyncStreamClient": "streams.async_stream",
    "Backoff": "streams.backoff",
    "ClientError": "client_errors",
    "InvalidAnswer": "client_errors",
    "LocalizationClient": "recordings.client",
    "NewSession": "streams.inbox",
    "Reconnecting": "streams.inbox",
    "ServiceProblem": "client_errors",
    "ServiceUnreachable": "client_errors",
    "StreamClient": "streams.stream",
    "StreamClosed": "client_errors",
    "StreamEvent": "streams.inbox",
    "StreamRefused": "client_errors",
    "Timeouts": "streams.connection",
}
"""Module of every name, imported on first use: the service's own processes need only the errors,
neither websockets nor asyncio"""


def __getattr__(name: str) -> typing.Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
