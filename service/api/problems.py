"""RFC 9457 problems: every error of every path in one shape, with a stable code."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match
from starlette.types import Receive, Scope, Send

from neuralmusic.errors import UNEXPECTED, DoaError, InvalidOption, RoleMissing, Unauthorized
from service.api.middleware.request_watch import PROBLEM

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:neuralmusic:problem:"
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
RETRY_AFTER = 2
"""Seconds to wait before a retry; a worker localizes minutes of audio in that time"""


class Problem(BaseModel):
    """What went wrong and what to do about it (RFC 9457)."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    type: str = Field(examples=[f"{TYPE_PREFIX}channel_mismatch"])
    """Identifies the kind of problem: `urn:neuralmusic:problem:` and the code"""
    title: str = Field(examples=["Channels do not fit the array"])
    """The kind of problem in words, the same for every occurrence"""
    status: int = Field(examples=[422])
    """The HTTP status"""
    detail: str = Field(
        examples=[
            "the audio has 8 channels, but the array respeaker-usb-4mic-v2 has 4 microphones: pass "
            "channel_map (--channel-map) with the 4 channels of the raw microphones"
        ]
    )
    """What happened this time, and what to do"""
    code: str = Field(examples=["channel_mismatch"])
    """Stable identifier for programs; its meaning never changes"""


class ProblemResponse(JSONResponse):
    """A problem; its code is left in the scope for ``RequestWatch``."""

    media_type = MEDIA_TYPE

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[PROBLEM] = self.code
        await super().__call__(scope, receive, send)

    def __init__(
        self, code: str, status: int, title: str, detail: str, headers: Mapping[str, str] | None
    ) -> None:
        self.code = code
        super().__init__(_fields(code, status, title, detail), status, headers)


def problem_response(error: DoaError) -> Response:
    """The response for an error."""
    return ProblemResponse(error.code, error.status, error.title, error.detail, _headers(error))


def problem_responses(*errors: type[DoaError]) -> dict[int | str, dict[str, Any]]:
    """OpenAPI responses with each of these errors as an example."""
    responses: dict[int | str, dict[str, Any]] = {}
    for status in sorted({error.status for error in errors}):
        alike = sorted((e for e in errors if e.status == status), key=lambda error: error.code)
        responses[status] = {
            # The status' phrase would differ between versions of Python.
            "description": ", ".join(f"`{error.code}`" for error in alike),
            "content": {
                MEDIA_TYPE: {
                    "schema": {"$ref": "#/components/schemas/Problem"},
                    "examples": {error.code: _example(error) for error in alike},
                }
            },
        }
        if any(map(_may_pass_later, alike)):
            seconds = {"description": "Seconds", "schema": {"type": "integer"}}
            responses[status]["headers"] = {"Retry-After": seconds}
        if status == HTTPStatus.UNAUTHORIZED:
            challenge = {"description": "`Bearer`", "schema": {"type": "string"}}
            responses[status]["headers"] = {"WWW-Authenticate": challenge}
    return responses


def install_problem_handlers(app: FastAPI) -> None:
    """Turn everything that can go wrong in a request into a problem."""
    app.add_exception_handler(DoaError, _on_doa_error)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    app.add_exception_handler(Exception, _on_unexpected)
    app.router.default = _on_no_route


async def _on_doa_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, DoaError)
    if error.status >= HTTPStatus.INTERNAL_SERVER_ERROR and not error.retryable:
        log.error("%s: %s", error.code, error.detail, exc_info=error)
    return problem_response(error)


async def _on_no_route(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a path without a route; Starlette refuses a WebSocket there without a word."""
    if scope["type"] == "http":
        raise HTTPException(HTTPStatus.NOT_FOUND)
    detail = f"there is no WebSocket at {scope['path'][:80]}: streams are at /stream"
    response = ProblemResponse("not_found", HTTPStatus.NOT_FOUND, "Not found", detail, None)
    await response(scope, receive, send)


async def _on_http_exception(request: Request, error: Exception) -> Response:
    """Answer Starlette's own refusals: no such path, wrong method."""
    assert isinstance(error, HTTPException)
    status, path = error.status_code, request.url.path
    code, title, detail = f"http_{status}", "Refused", error.detail
    if status == HTTPStatus.NOT_FOUND:
        code, title = "not_found", "Not found"
        detail = f"there is nothing at {path[:80]}: GET / lists what there is"
        if _is_websocket(request):
            detail = f"{path[:80]} is a WebSocket: connect to it with ws:// or wss://"
    elif status == HTTPStatus.METHOD_NOT_ALLOWED:
        code, title = "method_not_allowed", "Method not allowed"
        allowed = ", ".join(_allowed(request))
        detail = f"{path[:80]} takes {allowed}, not {request.method}"
        return ProblemResponse(code, status, title, detail, {"Allow": allowed})
    return ProblemResponse(code, status, title, detail, error.headers)


def _is_websocket(request: Request) -> bool:
    scope = {**request.scope, "type": "websocket"}
    return any(route.matches(scope)[0] is Match.FULL for route in request.app.router.routes)


def _allowed(request: Request) -> list[str]:
    """The methods of a path; Starlette's own Allow knows only its first route."""

    def takes(method: str) -> bool:
        scope = {**request.scope, "method": method}
        return any(route.matches(scope)[0] is Match.FULL for route in request.app.router.routes)

    return [method for method in METHODS if takes(method)]


async def _on_validation_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    return problem_response(InvalidOption(f"{place}: {first['msg']}"))


async def _on_disconnect(request: Request, error: Exception) -> Response:
    return Response(status_code=HTTPStatus.BAD_REQUEST)  # the client has left


async def _on_unexpected(request: Request, error: Exception) -> Response:
    """Hide the cause; the server logs the traceback and closes the connection."""
    response = problem_response(DoaError(UNEXPECTED))
    response.headers["Connection"] = "close"
    return response


def _headers(error: DoaError) -> dict[str, str]:
    if isinstance(error, Unauthorized):
        return {
            "WWW-Authenticate": _challenge("" if error.code == "key_missing" else "invalid_token")
        }
    if isinstance(error, RoleMissing):
        return {"WWW-Authenticate": _challenge("insufficient_scope")}
    if _may_pass_later(error):
        return {"Retry-After": str(math.ceil(error.retry_after_s or RETRY_AFTER))}
    return {}


def _may_pass_later(error: DoaError | type[DoaError]) -> bool:
    return error.retryable or error.status == HTTPStatus.TOO_MANY_REQUESTS


def _challenge(error: str) -> str:
    """``WWW-Authenticate`` by RFC 6750, which gives no error to a request without a key."""
    return 'Bearer realm="neuralmusic"' + (f', error="{error}"' if error else "")


def _example(error: type[DoaError]) -> dict[str, Any]:
    detail = UNEXPECTED if error is DoaError else (error.__doc__ or "")
    value = _fields(error.code, error.status, error.title, detail)
    return {"summary": error.title, "value": value}


def _fields(code: str, status: int, title: str, detail: str) -> dict[str, Any]:
    problem = Problem(type=TYPE_PREFIX + code, title=title, status=status, detail=detail, code=code)
    return problem.model_dump()
