"""``POST /localize``: a recording in, directions out."""

from __future__ import annotations

from dataclasses import replace
from typing import BinaryIO

from fastapi import APIRouter, Request, Response

from service.api.contract import LOCALIZE_ERRORS, LOCALIZE_EXAMPLE, localize_operation
from service.api.guard import key_of
from service.api.options import LocalizeRequest, read_options
from service.api.problems import problem_responses
from service.api.schemas import LocalizationAnswer
from service.api.state import ServiceState, state_of
from service.api.upload import read_upload
from service.api.workers import Progress
from service.audio import Recording
from service.errors import InvalidOption
from service.inference.recording import localize_recording
from service.key_file import Key

MAX_WINDOWS = 50_000
"""Of one answer; each holds a spectrum in memory"""
MAX_SPECTRUM_WINDOWS = 10_000
"""Of one answer with spectra, which has 360 numbers for every window"""

router = APIRouter(tags=["localization"])


@router.post(
    "/localize",
    summary="Localize a recording",
    response_model=LocalizationAnswer,
    response_description="Directions per window and for the whole recording",
    responses={
        200: {"content": {"application/json": {"example": LOCALIZE_EXAMPLE}}},
        **problem_responses(*LOCALIZE_ERRORS),
    },
    openapi_extra=localize_operation(),
)
async def localize(request: Request) -> Response:
    """Directions of arrival of the sound in a multichannel recording.

    The recording is the multipart file field `audio`, or the raw body. Options are form fields or
    query parameters; `array` is required.
    """
    state = state_of(request)
    key = key_of(request)
    state.admit()
    state.workers.check()
    with state.keys.upload(key):
        async with read_upload(request) as upload:
            asked = read_options(upload.options)
            body = await state.workers.run(
                request, lambda progress: _answer(upload.file, asked, state, key, progress)
            )
    return Response(body, media_type="application/json")


def _answer(
    file: BinaryIO, asked: LocalizeRequest, state: ServiceState, key: Key, progress: Progress
) -> bytes:
    """The answer's JSON; everything that takes time is in here, in a worker thread."""
    registry = state.models()
    options = asked.options
    if asked.noise is not None:
        options = replace(options, noise=state.noise.get(asked.noise).noise)
    with Recording.open(file, state.audio_limits) as recording:
        _check_windows(recording.duration, asked)
        state.keys.charge(key, recording.duration)
        result = localize_recording(recording, options, registry, progress)
    return LocalizationAnswer.of(result, spectrum=asked.spectrum).to_json()


def _check_windows(duration: float, asked: LocalizeRequest) -> None:
    hop = asked.options.hop_s
    count = int(duration / hop) + 1
    most = MAX_SPECTRUM_WINDOWS if asked.spectrum else MAX_WINDOWS
    if count > most:
        spectra = " with spectra" if asked.spectrum else ""
        raise InvalidOption(
            f"{duration:.0f} s at hop_s={hop:g} are {count} windows, one answer has at most "
            f"{most}{spectra}: take hop_s={duration / most:.2g} or more, or split the recording"
        )
