"""The web page at the root, the API's page, their files, and the links that programs get instead.

The files are read once, so no path of a request ever reaches the file system.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from importlib.resources import files
from typing import Literal

from fastapi import APIRouter, HTTPException, Request, Response

from neuralmusic import __version__
from service.recordings.answers import Answer

router = APIRouter(tags=["service"])

MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""Media types by suffix; the system's table may differ, and ``nosniff`` then stops the modules"""
HEADERS = {
    # A browser revalidates its copy each time, so a page never mixes versions.
    "Cache-Control": "no-cache",
    # ws: and wss: are named because not every browser counts them as 'self'.
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws: wss:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'",
}
DOCS_HEADERS = {
    # Swagger UI's style sheet has its pictures in itself.
    "Content-Security-Policy": HEADERS["Content-Security-Policy"] + "; img-src 'self' data:",
}
SWAGGER_UI = ("swagger-ui.css", "swagger-ui-bundle.js")
"""Files of Swagger UI, which ``fastapi_offline`` carries"""


@dataclass(frozen=True, slots=True)
class PageFile:
    """One file of the page."""

    content: bytes
    media_type: str
    etag: str
    """Hash of the content: two versions of a file may have the same date"""


class RootAnswer(Answer):
    """Name, version and paths of the service."""

    name: Literal["neuralmusic"] = "neuralmusic"
    version: str
    links: dict[str, str]
    """Paths by what they lead to"""


@cache
def page_files() -> dict[str, PageFile]:
    """The page's files by their names."""
    found = {}
    swagger_ui = files("fastapi_offline").joinpath("static")
    own = files("service").joinpath("static").iterdir()
    for file in (*own, *(swagger_ui.joinpath(name) for name in SWAGGER_UI)):
        media_type = MEDIA_TYPES.get(f".{file.name.rpartition('.')[2]}")
        if media_type:
            content = file.read_bytes()
            digest = hashlib.sha256(content).hexdigest()[:32]
            found[file.name] = PageFile(content, media_type, f'"{digest}"')
    return found


def asks_for_page(accept: str) -> bool:
    """Whether an ``Accept`` header names HTML before JSON, as browsers do and curl does not.

    Only types that are written out count: programs without a preference send ``*/*``.
    """
    weights = {"text/html": 0.0, "application/json": 0.0}
    for part in accept.split(","):
        media_type, *parameters = (text.strip().lower() for text in part.split(";"))
        if media_type in weights:
            weights[media_type] = _weight(parameters)
    return weights["text/html"] > weights["application/json"]


def _weight(parameters: list[str]) -> float:
    try:
        return next((float(text[2:]) for text in parameters if text.startswith("q=")), 1.0)
    except ValueError:
        return 0.0


@router.get(
    "/",
    summary="Web page, or name, version and paths",
    response_model=RootAnswer,
    response_description="Where to go from here; the web page for clients that accept HTML",
    responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
)
@router.head("/", include_in_schema=False)
async def root(request: Request) -> Response:
    """The web page where `Accept` names `text/html`, as browsers do; else where to go from here."""
    if asks_for_page(request.headers.get("accept", "")):
        response = _file_response(request, page_files()["index.html"])
    else:
        response = Response(_signpost().model_dump_json(), media_type="application/json")
    response.headers["Vary"] = "Accept"
    return response


@router.get("/docs", include_in_schema=False)
@router.head("/docs", include_in_schema=False)
async def docs(request: Request) -> Response:
    """Swagger UI with the OpenAPI document; it works without the internet."""
    response = _file_response(request, page_files()["docs.html"])
    response.headers.update(DOCS_HEADERS)
    return response


@router.get("/static/{name}", include_in_schema=False)
@router.head("/static/{name}", include_in_schema=False)
async def static(request: Request, name: str) -> Response:
    """One of the page's files."""
    file = page_files().get(name)
    if file is None:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    return _file_response(request, file)


def _file_response(request: Request, file: PageFile) -> Response:
    headers = {**HEADERS, "ETag": file.etag}
    known = request.headers.get("if-none-match", "")
    if file.etag in (tag.strip().removeprefix("W/") for tag in known.split(",")):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(file.content, media_type=file.media_type, headers=headers)


def _signpost() -> RootAnswer:
    paths = {
        "localize": "/localize",
        "models": "/models",
        "arrays": "/arrays",
        "noise": "/noise",
        "stream": "/stream",
        "sessions": "/sessions",
        "documentation": "/docs",
        "openapi": "/openapi.json",
        "asyncapi": "/asyncapi.json",
    }
    return RootAnswer(version=__version__, links=paths)
