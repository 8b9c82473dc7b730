"""A deadline for request bodies: a client that sends nothing, or single bytes, is refused."""

from __future__ import annotations

import asyncio

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from neuralmusic.errors import RequestTimeout

BYTES_PER_S = 500
"""Rate at which a body is never too slow, as in Apache's mod_reqtimeout"""


class BodyDeadline:
    """ASGI middleware that gives up a body that falls behind.

    Only time spent waiting for the client counts.

    Parameters
    ----------
    app : ASGIApp
    seconds : float
        Most time that a body may fall behind ``BYTES_PER_S``, silence included.
    """

    def __init__(self, app: ASGIApp, seconds: float) -> None:
        self.app = app
        self.seconds = seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        patience, ended, late = self.seconds, False, False

        async def in_time() -> Message:
            nonlocal patience, ended, late
            if ended:  # the application waits for the client to leave
                return await receive()
            loop = asyncio.get_running_loop()
            began = loop.time()
            try:
                async with asyncio.timeout(patience):
                    message = await receive()
            except TimeoutError:
                late = True
                raise self._too_slow() from None  # inside the endpoint, which awaits the body
            ended = not message.get("more_body", False)
            left = patience - (loop.time() - began)
            patience = min(self.seconds, left + len(message.get("body", b"")) / BYTES_PER_S)
            return message

        async def last_word(message: Message) -> None:
            if late and message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Connection"] = "close"  # do not wait for the rest
            await send(message)

        await self.app(scope, in_time, last_word)

    def _too_slow(self) -> RequestTimeout:
        return RequestTimeout(
            f"the body fell {self.seconds:g} s behind {BYTES_PER_S} bytes a second: send it again "
            "over a better connection, or send FLAC"
        )
