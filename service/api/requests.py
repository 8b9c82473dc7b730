"""Every request and handshake: an id, a line in the log, a count."""

from __future__ import annotations

import logging
import re
import secrets
import time
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.logs import request_id
from service.metrics import OTHER, Metrics

log = logging.getLogger(__name__)

HEADER = "X-Request-ID"
SANE_ID = re.compile(r"[A-Za-z0-9._:+/=@-]{1,128}")
"""Ids of clients and proxies that are taken over; others could not be told apart in a log"""
PROBLEM = "neuralmusic.problem"
"""Where a problem's response leaves its code in the scope"""
QUIET = ("/livez", "/readyz", "/metrics")
"""Asked every few seconds; logged at ``debug`` where all is well"""
SHOWN_PATH = 200
"""Characters of a path in the log"""
GONE = 499
"""Status where the client left before it was answered"""
ANSWERS = ("http.response.start", "websocket.http.response.start", "websocket.accept")


class RequestWatch:
    """ASGI middleware around everything, the answer to a defect included."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        began = time.perf_counter()
        given = Headers(scope=scope).get(HEADER, "")
        ident = given if SANE_ID.fullmatch(given) else secrets.token_hex(8)
        token = request_id.set(ident)
        status = 0

        async def answered(message: Message) -> None:
            nonlocal status
            if message["type"] in ANSWERS:
                accepted = message["type"] == "websocket.accept"
                status = HTTPStatus.SWITCHING_PROTOCOLS if accepted else message["status"]
                header = (HEADER.lower().encode(), ident.encode())
                message = {**message, "headers": [*message.get("headers", ()), header]}
                if accepted:  # a stream is told of when it ends, and it is no answer to wait for
                    self._count(scope, status, None)
            await send(message)

        try:
            await self.app(scope, receive, answered)
        except Exception:
            # The id stays for the line that the server logs with the traceback.
            self._finish(scope, status or HTTPStatus.INTERNAL_SERVER_ERROR, began)
            raise
        except BaseException:
            self._finish(scope, status or GONE, began)
            request_id.reset(token)
            raise
        self._finish(scope, status or GONE, began)
        request_id.reset(token)

    def _finish(self, scope: Scope, status: int, began: float) -> None:
        code = scope.get(PROBLEM)
        if code is not None:
            self._metrics.refused(code)
        if status == HTTPStatus.SWITCHING_PROTOCOLS:
            return
        seconds = time.perf_counter() - began
        self._count(scope, status, seconds)
        path = scope["path"][:SHOWN_PATH]
        client = scope.get("client")
        fields = {
            "method": _method(scope),
            "path": path,
            "status": int(status),
            "duration_ms": round(1000 * seconds, 1),
            "client": client[0] if client else None,
        }
        if code is not None:
            fields["code"] = code
        level = _level(status)
        if level == logging.INFO and path in QUIET:
            level = logging.DEBUG
        log.log(level, "%s %s %d", fields["method"], path, status, extra=fields)

    def _count(self, scope: Scope, status: int, seconds: float | None) -> None:
        self._metrics.requested(_method(scope), route_template(scope), status, seconds)


def route_template(scope: Scope) -> str:
    """The path of the route that took the request, ``/models/{name}``, or ``other``."""
    route = scope.get("route")
    if route is not None:
        return str(route.path)
    app = scope.get("app")
    documents = (app.openapi_url, app.docs_url) if app is not None else ()
    return scope["path"] if scope["path"] in documents else OTHER


def _method(scope: Scope) -> str:
    return "WEBSOCKET" if scope["type"] == "websocket" else str(scope["method"])


def _level(status: int) -> int:
    if status < HTTPStatus.INTERNAL_SERVER_ERROR:
        return logging.INFO
    return logging.WARNING if status == HTTPStatus.SERVICE_UNAVAILABLE else logging.ERROR
