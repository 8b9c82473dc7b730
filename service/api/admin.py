"""``POST /admin/reload``: models and keys read again while the service runs."""

from __future__ import annotations

from fastapi import APIRouter, Request

from neuralmusic.errors import Draining, NotReady, ReloadRefused
from service.api.problems import problem_responses
from service.api.schemas import ModelsAnswer
from service.api.state import state_of

router = APIRouter(prefix="/admin", tags=["service"])


@router.post(
    "/reload",
    summary="Load models and keys again",
    responses=problem_responses(ReloadRefused, NotReady, Draining),
)
async def reload(request: Request) -> ModelsAnswer:
    """Read bundles and keys again, verify and self-test them, and use them, as SIGHUP does.

    Running streams and recordings keep the models that they began with. Keys are read first: a file
    that cannot be used is refused, and everything stays as it was. A bundle that cannot be used is
    refused, too, and the models stay as they were; the new keys hold. Reloads that are asked for
    while one runs are one more.
    """
    state = state_of(request)
    state.admit()
    return ModelsAnswer.of((await state.reload()).bundles)
