"""A hard limit on request bodies, declared or not, for every path."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from neuralmusic.errors import UploadTooLarge
from service.api.problems import problem_response


class BodyLimit:
    """ASGI middleware that refuses a large Content-Length and counts bodies without one."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self.app = app
        self.max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if self._declared(scope) > self.max_bytes:
            await problem_response(self._too_large())(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self.max_bytes:
                raise self._too_large()  # inside the endpoint, which awaits the body
            return message

        await self.app(scope, counted, send)

    @staticmethod
    def _declared(scope: Scope) -> int:
        value = Headers(scope=scope).get("content-length", "")
        return int(value) if value.isdecimal() and len(value) < 20 else 0

    def _too_large(self) -> UploadTooLarge:
        return UploadTooLarge(
            f"the body is larger than {self.max_bytes} bytes: split the recording, or send FLAC"
        )
