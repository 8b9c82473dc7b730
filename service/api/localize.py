"""``POST /localize``: a recording in, directions out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import anyio.to_thread
from fastapi import APIRouter, Request, Response
from starlette.requests import ClientDisconnect

from service.api.contract.localize import LOCALIZE_ERRORS, localize_operation
from service.api.middleware.guard import key_of
from service.api.problems import problem_responses
from service.api.state import ServiceState, state_of
from service.api.upload import read_upload
from service.observability.logs import request_id
from service.recordings.answers import LocalizationAnswer
from service.recordings.job import RecordingJob
from service.recordings.options import LocalizeRequest, read_options

router = APIRouter(tags=["localization"])


@router.post(
    "/localize",
    summary="Localize a recording",
    response_model=LocalizationAnswer,
    response_description="Directions per window and for the whole recording",
    responses=problem_responses(*LOCALIZE_ERRORS),
    openapi_extra=localize_operation(),
)
async def localize(request: Request) -> Response:
    """Directions of arrival of the sound in a multichannel recording.

    The recording is the multipart file field `audio`, or the raw body. Options are form fields or
    query parameters; `array` is required.
    """
    state = state_of(request)
    key = key_of(request)

    async def still_wanted() -> None:
        if await request.is_disconnected():
            raise ClientDisconnect

    state.admit()
    state.recording_workers.check()
    with state.keys.upload(key):
        async with read_upload(request, state.spool) as upload:
            asked = await _with_noise(read_options(upload.options), state)
            job = RecordingJob(asked, state.audio_limits, request_id.get())
            with state.traces.span("localize"):
                localized = await state.recording_workers.run(
                    job, upload.file, partial(state.keys.reserve, key), still_wanted
                )
    return Response(localized.body, media_type="application/json")


async def _with_noise(asked: LocalizeRequest, state: ServiceState) -> LocalizeRequest:
    """The request with the noise profile that it names."""
    if asked.noise is None:
        return asked
    stored = await anyio.to_thread.run_sync(state.noise.get, asked.noise)
    return replace(asked, options=replace(asked.options, noise=stored.noise))
