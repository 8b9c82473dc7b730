"""Health probes; they touch no model."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request, Response

from neuralmusic.errors import Draining, NotReady
from service.api.contract.asyncapi import document_json
from service.api.problems import problem_responses
from service.api.state import state_of
from service.recordings.answers import Answer

router = APIRouter(tags=["service"])


class StatusAnswer(Answer):
    """The service's status."""

    status: Literal["ok"] = "ok"


@router.head("/livez", include_in_schema=False)
@router.get("/livez", summary="Is the process alive?")
async def livez() -> StatusAnswer:
    """200 as long as the process answers."""
    return StatusAnswer()


@router.head("/readyz", include_in_schema=False)
@router.get(
    "/readyz",
    summary="Can requests be served?",
    responses=problem_responses(NotReady, Draining),
)
async def readyz(request: Request) -> StatusAnswer:
    """200 from when the models are loaded and self-tested until shutdown begins, else 503.

    Also 503 while no stream worker or no recording worker is ready.
    """
    state_of(request).check_ready()
    return StatusAnswer()


@router.get(
    "/asyncapi.json",
    summary="The stream's contract",
    response_class=Response,
    responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}},
)
async def asyncapi() -> Response:
    """The AsyncAPI document of the WebSocket `/stream`."""
    return Response(document_json(), media_type="application/json")
