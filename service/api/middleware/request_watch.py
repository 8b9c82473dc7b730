"""An id, a line in the log and a count for every request and handshake."""

from __future__ import annotations

import logging
import re
import secrets
import time
from collections.abc import Iterable
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.observability.logs import request_id
from service.observability.metrics import OTHER, Metrics

log = logging.getLogger(__name__)

HEADER = "X-Request-ID"
SANE_ID = re.compile(r"[A-Za-z0-9._:+/=@-]{1,128}")
"""Request ids accepted from clients and proxies; any other is replaced"""
PROBLEM = "neuralmusic.problem"
"""Key of the scope under which a problem's response leaves its code"""
QUIET = ("/livez", "/readyz", "/metrics")
"""Paths asked every few seconds; their successes are logged at ``debug``"""
SHOWN_PATH = 200
"""Most characters of a path in the log"""
GONE = 499
"""Status of a request whose client left before the answer"""
ANSWERS = ("http.response.start", "websocket.http.response.start", "websocket.accept")


class RequestWatch:
    """ASGI middleware around everything, the answer to a defect included.

    Parameters
    ----------
    templates : iterable of str
        Paths of the routes, as ``/models/{name}``; all others are counted as ``other``.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, templates: Iterable[str]) -> None:
        self.app = app
        self._metrics = metrics
        self._templates = {template: compile_path(template)[0] for template in templates}

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
                if accepted:  # a stream is logged when it ends, and its length is no response time
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
        self._metrics.requested(_method(scope), self._template(scope), status, seconds)

    def _template(self, scope: Scope) -> str:
        """The template that the path matches: a refused request has met no route."""
        path = route_path(scope)
        if path in self._templates:
            return path
        matching = (name for name, regex in self._templates.items() if regex.match(path))
        return next(matching, OTHER)


def route_path(scope: Scope) -> str:
    """The path as routes see it, without the prefix that a proxy puts before the application."""
    path: str = scope["path"]
    prefix: str = scope.get("root_path", "")
    return path[len(prefix) :] if path.startswith(f"{prefix}/") else path


def _method(scope: Scope) -> str:
    return "WEBSOCKET" if scope["type"] == "websocket" else str(scope["method"])


def _level(status: int) -> int:
    if status < HTTPStatus.INTERNAL_SERVER_ERROR:
        return logging.INFO
    return logging.WARNING if status == HTTPStatus.SERVICE_UNAVAILABLE else logging.ERROR
