"""Probes for whoever runs the service, and a signpost at the root; no model is touched."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request

from service import __version__
from service.api.problems import problem_responses
from service.api.schemas import Answer
from service.api.state import state_of
from service.errors import Draining, NotReady

router = APIRouter(tags=["service"])


class StatusAnswer(Answer):
    """That the service is there."""

    status: Literal["ok"] = "ok"


class RootAnswer(Answer):
    """What there is."""

    name: Literal["neuralmusic"] = "neuralmusic"
    version: str
    links: dict[str, str]
    """Paths by what they are"""


@router.get("/livez", summary="Is the process alive?")
async def livez() -> StatusAnswer:
    """200 as long as the process answers."""
    return StatusAnswer()


@router.get(
    "/readyz",
    summary="Can requests be served?",
    responses=problem_responses(NotReady, Draining),
)
async def readyz(request: Request) -> StatusAnswer:
    """200 once the models are loaded and self-tested and until the service stops, else 503."""
    state_of(request).admit()
    return StatusAnswer()


@router.get("/", summary="Name, version and paths")
async def root() -> RootAnswer:
    """Where to go from here."""
    paths = {
        "localize": "/localize",
        "models": "/models",
        "arrays": "/arrays",
        "noise": "/noise",
        "documentation": "/docs",
        "openapi": "/openapi.json",
    }
    return RootAnswer(version=__version__, links=paths)
