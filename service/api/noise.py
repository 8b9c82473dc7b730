"""``/noise``: profiles of robots' own noises, stored by name."""

from __future__ import annotations

from datetime import datetime
from http import HTTPStatus
from tempfile import SpooledTemporaryFile
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, HTTPException, Path, Request, Response
from starlette.datastructures import UploadFile

from neuralmusic.errors import (
    DiskFull,
    InvalidOption,
    NoiseProfileInvalid,
    NoiseStoreFull,
    RequestTimeout,
    TooManyConnections,
    UnknownNoise,
    UploadTooLarge,
)
from neuralmusic.protocol.names import NAME_RULE
from service.api.catalog import NOT_FOUND
from service.api.middleware.guard import key_of
from service.api.problems import problem_responses
from service.api.state import state_of
from service.api.upload import arriving, unstored
from service.inference.noise_profile import MAX_BYTES, load_noise, noise_bytes
from service.inference.noise_store import NoiseStore, StoredNoise
from service.recordings.answers import Answer

MEDIA_TYPE = "application/octet-stream"
BINARY = {"schema": {"type": "string", "format": "binary"}}
SPOOL_BYTES = 2**20
"""Largest profile kept in memory while it arrives; those of real arrays are smaller"""

router = APIRouter(tags=["noise"])

Name = Annotated[str, Path(description=f"{NAME_RULE}.")]


class NoiseAnswer(Answer):
    """A stored profile of a robot's own noise."""

    name: str
    """Name for `noise` of `POST /localize`"""
    array: str
    """Name of the array that the noise was learnt with"""
    positions_m: list[list[float]]
    """Metres, `[x, y, z]` per microphone of that array"""
    seconds: float
    """Seconds of audio that the noise was learnt from"""
    created: datetime
    """Time at which the profile was stored, UTC"""

    @classmethod
    def of(cls, stored: StoredNoise) -> NoiseAnswer:
        noise = stored.noise
        return cls(
            name=stored.name,
            array=noise.array.name,
            positions_m=noise.array.positions.tolist(),
            seconds=round(noise.seconds, 3),
            created=stored.created,
        )


class NoisesAnswer(Answer):
    """All stored profiles."""

    noise: list[NoiseAnswer]
    """Profiles, sorted by name"""


@router.get("/noise", summary="List the noise profiles")
async def list_noise(request: Request) -> NoisesAnswer:
    """The stored profiles of robots' own noises."""
    stored = await anyio.to_thread.run_sync(_store(request).all)
    return NoisesAnswer(noise=[NoiseAnswer.of(each) for each in stored])


@router.get(
    "/noise/{name}",
    summary="Download a noise profile",
    response_class=Response,
    responses=NOT_FOUND | {200: {"content": {MEDIA_TYPE: BINARY}}},
)
async def get_noise(request: Request, name: Name) -> Response:
    """The file that `PUT` took, or that `neuralmusic noise` would have written."""
    stored = await _found(request, name)
    headers = {"Content-Disposition": f'attachment; filename="{stored.name}.npz"'}
    content = await anyio.to_thread.run_sync(noise_bytes, stored.noise)
    return Response(content, media_type=MEDIA_TYPE, headers=headers)


@router.put(
    "/noise/{name}",
    summary="Store a noise profile",
    responses=problem_responses(
        InvalidOption,
        NoiseProfileInvalid,
        NoiseStoreFull,
        RequestTimeout,
        UploadTooLarge,
        DiskFull,
        TooManyConnections,
    ),
    openapi_extra={"requestBody": {"required": True, "content": {MEDIA_TYPE: BINARY}}},
)
async def put_noise(request: Request, name: Name) -> NoiseAnswer:
    """Store a profile that `neuralmusic noise` wrote; it replaces one of the same name."""
    state = state_of(request)
    with state.keys.upload(key_of(request)), SpooledTemporaryFile(SPOOL_BYTES) as file:
        async with arriving(request, state.spool) as pieces:
            spooled, size = UploadFile(file, size=0), 0  # type: ignore[arg-type]
            async for piece in pieces.stream():
                size += len(piece)
                if size > MAX_BYTES:
                    raise UploadTooLarge(f"a noise profile has at most {MAX_BYTES} bytes")
                await spooled.write(piece)
            await spooled.seek(0)

        def keep() -> StoredNoise:
            noise = load_noise(file)  # type: ignore[arg-type]
            try:
                return state.noise.put(name, noise)
            except OSError as error:
                raise unstored(error, "profile") from error

        return NoiseAnswer.of(await anyio.to_thread.run_sync(keep, limiter=state.noise_checks))


@router.delete(
    "/noise/{name}",
    summary="Delete a noise profile",
    status_code=HTTPStatus.NO_CONTENT,
    responses=NOT_FOUND | problem_responses(DiskFull, TooManyConnections),
)
async def delete_noise(request: Request, name: Name) -> None:
    """Forget a profile."""
    try:
        await anyio.to_thread.run_sync(_store(request).delete, name)
    except UnknownNoise as error:
        raise HTTPException(HTTPStatus.NOT_FOUND) from error
    except OSError as error:
        raise unstored(error, "deletion") from error


def _store(request: Request) -> NoiseStore:
    return state_of(request).noise


async def _found(request: Request, name: str) -> StoredNoise:
    """The profile of this name; 404 where there is none."""
    try:
        return await anyio.to_thread.run_sync(_store(request).get, name)
    except UnknownNoise as error:
        raise HTTPException(HTTPStatus.NOT_FOUND) from error
