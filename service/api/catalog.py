"""``GET /models`` and ``GET /arrays``: what requests may name."""

from __future__ import annotations

from fastapi import APIRouter, Request

from service.api.problems import problem_responses
from service.api.schemas import ArraysAnswer, BundleAnswer, ModelsAnswer, PresetAnswer
from service.api.state import state_of
from service.doa.presets import PRESETS
from service.errors import NotReady

router = APIRouter(tags=["catalog"])


@router.get("/models", summary="List the models", responses=problem_responses(NotReady))
async def models(request: Request) -> ModelsAnswer:
    """The loaded model bundles with their hashes and scores."""
    bundles = state_of(request).models().bundles
    return ModelsAnswer(models=[BundleAnswer.of(b, default=b is bundles[0]) for b in bundles])


@router.get("/arrays", summary="List the array presets")
async def arrays() -> ArraysAnswer:
    """The microphone arrays that requests may name, with positions and raw channels."""
    return ArraysAnswer(arrays=[PresetAnswer.of(array) for array in PRESETS.values()])
