"""``GET /models`` and ``GET /arrays``: what requests may name."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from fastapi import APIRouter, HTTPException, Request

from neuralmusic.errors import NotReady, UnknownModel
from service.api.problems import MEDIA_TYPE, problem_responses
from service.api.schemas import (
    ArraysAnswer,
    ModelCardAnswer,
    ModelsAnswer,
    PresetAnswer,
)
from service.api.state import state_of
from service.doa.presets import PRESETS

router = APIRouter(tags=["catalog"])

NOT_FOUND: dict[int | str, dict[str, Any]] = {
    404: {
        "description": "`not_found`",
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
}


@router.get("/models", summary="List the models", responses=problem_responses(NotReady))
async def models(request: Request) -> ModelsAnswer:
    """The loaded model bundles with what they are for, their hashes and scores, the best first."""
    return ModelsAnswer.of(state_of(request).models().bundles)


@router.get(
    "/models/{name}",
    summary="Show a model with its card",
    responses=NOT_FOUND | problem_responses(NotReady),
)
async def model(request: Request, name: str) -> ModelCardAnswer:
    """One loaded model bundle with its card: intended use, training data, limits."""
    registry = state_of(request).models()
    try:
        bundle = registry.get(name)
    except UnknownModel as error:
        raise HTTPException(HTTPStatus.NOT_FOUND) from error
    return ModelCardAnswer.of(bundle, default=bundle is registry.bundles[0])


@router.get("/arrays", summary="List the array presets")
async def arrays() -> ArraysAnswer:
    """The microphone arrays that requests may name, with positions and raw channels."""
    return ArraysAnswer(arrays=[PresetAnswer.of(array) for array in PRESETS.values()])
