"""Access control: checks every request and every stream before its endpoint sees it."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import cast
from urllib.parse import parse_qsl

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from neuralmusic.errors import DoaError, KeyInAddress
from service.access.key_file import ROLES, Key, Role
from service.access.keys import ANYONE, Keys
from service.api.middleware.hosts import check_host, is_loopback
from service.api.middleware.origins import SAFE_METHODS, check_origin
from service.api.middleware.request_watch import route_path
from service.api.problems import problem_response
from service.settings import Settings

PUBLIC: tuple[Role, ...] = ()
"""Roles of a path that needs no key"""
NEEDED: Mapping[str, tuple[Role, ...]] = {
    "static": PUBLIC,
    "docs": PUBLIC,
    "openapi.json": PUBLIC,
    "asyncapi.json": PUBLIC,
    "livez": PUBLIC,
    "readyz": PUBLIC,
    "models": ROLES,
    "arrays": ROLES,
    "localize": ("localize",),
    "noise": ("localize",),
    "stream": ("stream",),
    "sessions": ("watch",),
    "metrics": ("watch",),
    "admin": ("admin",),
}
"""Accepted roles by the first part of a path; paths without a rule need ``admin``"""

SUBPROTOCOL_PREFIX = "bearer."
"""Prefix of the WebSocket subprotocol that carries a web page's key; pages cannot set headers"""
IN_ADDRESS = frozenset({"key", "token", "access_token", "api_key", "apikey"})
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: no guessed types, no referrer, no use by other sites' pages"""


def needed_roles(path: str) -> tuple[Role, ...]:
    """Roles of which a key for this path must have one; empty where no key is needed."""
    return PUBLIC if path == "/" else NEEDED.get(_first_part(path), ("admin",))


def key_of(connection: HTTPConnection) -> Key:
    """The key of an admitted request."""
    key: Key = connection.state.key
    return key


class Guard:
    """ASGI middleware that checks host, key, role and origin, and adds the security headers."""

    def __init__(self, app: ASGIApp, settings: Settings, keys: Keys) -> None:
        self.app = app
        self._settings = settings
        self._keys = keys
        self._only_here = not keys.needed and is_loopback(settings.host)
        """True where the ``Host`` header is the only defence against DNS rebinding"""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def send_safely(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            key = self._admitted(scope)
        except DoaError as error:
            await problem_response(error)(scope, receive, send_safely)
            return
        scope.setdefault("state", {})["key"] = key
        await self.app(scope, receive, send_safely)

    def _admitted(self, scope: Scope) -> Key:
        """The key of a connection, or an error that says why it is refused."""
        headers = Headers(scope=scope)
        if self._settings.hosts or self._only_here:
            check_host(scope, headers.get("host", ""), self._settings.hosts)
        _refuse_keys_in_address(scope)
        roles = needed_roles(route_path(scope))
        key = ANYONE
        if roles and _leads_somewhere(scope):
            key = self._keys.check(self._keys.authenticate(_token(scope, headers)), *roles)
        if scope["type"] == "websocket" or scope["method"] not in SAFE_METHODS:
            check_origin(headers, (*self._settings.origins, *key.origins))
        return key


def _token(scope: Scope, headers: Headers) -> str | None:
    """The token of a request, from the header or an offered subprotocol."""
    scheme, _, token = headers.get("authorization", "").strip().partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    for offered in scope.get("subprotocols", ()):
        if offered.startswith(SUBPROTOCOL_PREFIX):
            return _decoded(offered.removeprefix(SUBPROTOCOL_PREFIX))
    return None


def _decoded(text: str) -> str:
    """Text decoded from base64url; other text comes back as it is and matches no key."""
    try:
        return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)).decode("ascii")
    except (binascii.Error, ValueError):
        return text


def _refuse_keys_in_address(scope: Scope) -> None:
    query = scope.get("query_string", b"").decode("latin-1")
    if "=" not in query:
        return
    try:
        names = {name.lower() for name, _ in parse_qsl(query, keep_blank_values=True)}
    except ValueError:
        return
    found = sorted(names & IN_ADDRESS)
    if found:
        scope["query_string"] = b""  # the server's access log reads it afterwards
        raise KeyInAddress(
            f"{found[0]} in the address: logs and histories keep addresses, so revoke this key "
            "if it was one, and send keys as the header Authorization: Bearer KEY"
        )


def _leads_somewhere(scope: Scope) -> bool:
    """Whether an endpoint has this path; without one the 404 needs no key."""
    if _first_part(route_path(scope)) in NEEDED:
        return True
    routes = cast(Starlette, scope["app"]).routes
    return any(route.matches(scope)[0] is not Match.NONE for route in routes)


def _first_part(path: str) -> str:
    return path.removeprefix("/").partition("/")[0]
