"""Request bodies: a multipart form or raw audio, spooled to disk and always closed."""

from __future__ import annotations

import errno
import logging
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import BinaryIO

from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request

from neuralmusic.errors import (
    DiskFull,
    DoaError,
    InvalidOption,
    MissingAudio,
    TooManyConnections,
    UnsupportedMediaType,
    UploadError,
)
from service.api.spool import Arrival, Spool
from service.machine.files import TOO_MANY_FILES, out_of_files
from service.observability.logs import RareLine

FIELD = "audio"
MAX_FIELDS = 32
MAX_FILES = 4
MAX_FIELD_BYTES = 64 * 2**10

PIECE_BYTES = 2**20
"""Least bytes of a body in a piece: each piece crosses to a thread that writes it to the disk"""

NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
"""Errors that pass by themselves; what else a disk says is for the operator"""
told = RareLine(logging.getLogger(__name__))

HOW = "send the recording as multipart field 'audio' (curl -F audio=@recording.wav)"


class Pieces(Request):
    """A request that joins the server's many small pieces of a body into few large ones."""

    def __init__(self, request: Request, arrival: Arrival) -> None:
        super().__init__(request.scope, request.receive)
        self._arrival = arrival

    async def stream(self) -> AsyncGenerator[bytes, None]:
        """The body in pieces of at least ``PIECE_BYTES``, except the last one."""
        piece = bytearray()
        async for chunk in super().stream():
            piece += chunk
            self._arrival.received(len(chunk))
            if len(piece) >= PIECE_BYTES:
                await self._arrival.make_room(len(piece))
                yield bytes(piece)
                piece.clear()
        await self._arrival.make_room(len(piece))
        yield bytes(piece)


@dataclass(frozen=True, slots=True)
class Upload:
    """A recording as it arrived, with its options."""

    file: BinaryIO
    options: list[tuple[str, str]]


@asynccontextmanager
async def arriving(request: Request, spool: Spool) -> AsyncIterator[Pieces]:
    """The request while its body is read and stored.

    Raises
    ------
    DiskFull, TooManyConnections
        If the body cannot be stored.
    RequestTimeout
        If it was too slow when another upload needed its room.
    """
    try:
        async with spool.arriving() as arrival:
            yield Pieces(request, arrival)
    except OSError as error:
        raise unstored(error, "upload") from error


@asynccontextmanager
async def read_upload(request: Request, spool: Spool) -> AsyncIterator[Upload]:
    """The request's recording and options; the temporary file lasts as long as the context.

    Raises
    ------
    UnsupportedMediaType
        If the body is neither a form nor audio.
    MissingAudio
        If the body holds no recording.
    UploadTooLarge
        If the body exceeds the limit while it is read.
    DiskFull, RequestTimeout, TooManyConnections
        As ``arriving`` does.
    """
    is_form = _media_type(request) == "multipart/form-data"
    async with AsyncExitStack() as stack:
        async with arriving(request, spool) as pieces:
            body = _form(pieces) if is_form else _raw(pieces)
            upload, size = await stack.enter_async_context(body)
            # A worker process gets the file's descriptor; the file has no name.
            upload.file.fileno()
            upload.file.flush()
        if not size:
            raise MissingAudio(f"the recording is empty (0 bytes): {HOW}")
        yield upload


def unstored(error: OSError, what: str) -> DoaError:
    """Why something that a client sent cannot be kept."""
    if out_of_files(error):
        return TooManyConnections(TOO_MANY_FILES)
    if error.errno in NO_ROOM:
        return DiskFull(f"there is no room to store the {what}: try again later")
    told.warning("what clients send cannot be stored: %s", error)
    return DiskFull(f"the {what} cannot be stored: the service's log says why, tell its operator")


def _media_type(request: Request) -> str:
    """The body's media type, or UnsupportedMediaType."""
    header = request.headers.get("content-type", "application/octet-stream")
    media_type = header.partition(";")[0].strip().lower()
    if media_type.startswith("audio/") or media_type in (
        "multipart/form-data",
        "application/octet-stream",
        "application/ogg",
    ):
        return media_type
    hint = " (curl's default for --data-binary: add -H 'Content-Type: audio/wav')"
    raise UnsupportedMediaType(
        f"the body is {media_type[:80]!r}"
        f"{hint if media_type == 'application/x-www-form-urlencoded' else ''}: "
        "send multipart/form-data with the file field 'audio', or a raw body with Content-Type "
        "audio/wav, audio/flac or application/octet-stream"
    )


@asynccontextmanager
async def _form(request: Request) -> AsyncIterator[tuple[Upload, int]]:
    """A form's recording with its size in bytes, and its fields."""
    _check_charset(request)
    limits = {"max_files": MAX_FILES, "max_fields": MAX_FIELDS, "max_part_size": MAX_FIELD_BYTES}
    try:
        form = await request.form(**limits)
    except HTTPException as error:
        raise UploadError(f"the multipart body cannot be read: {error.detail} {HOW}") from error
    try:
        audio, fields = _split(form)
        options = request.query_params.multi_items() + fields
        yield Upload(audio.file, options), audio.size or 0
    finally:
        await form.close()


def _check_charset(request: Request) -> None:
    """Raise UploadError where the form's charset is not UTF-8: some codecs give no text at all."""
    charset = parse_options_header(request.headers["content-type"])[1].get(b"charset", b"utf-8")
    if charset.lower() not in (b"utf-8", b"utf8", b"us-ascii"):
        raise UploadError(f"the form's charset is {charset.decode('latin-1')[:40]!r}: send UTF-8")


@asynccontextmanager
async def _raw(request: Request) -> AsyncIterator[tuple[Upload, int]]:
    """The whole body as the recording, with its size in bytes."""
    with TemporaryFile() as file:
        spooled = UploadFile(file, size=0)
        async for chunk in request.stream():
            await spooled.write(chunk)
        await spooled.seek(0)
        yield Upload(spooled.file, request.query_params.multi_items()), spooled.size or 0


def _split(form: FormData) -> tuple[UploadFile, list[tuple[str, str]]]:
    """The form's recording and its other fields."""
    audio: UploadFile | None = None
    fields: list[tuple[str, str]] = []
    for name, value in form.multi_items():
        if name == FIELD:
            if isinstance(value, str):
                raise MissingAudio(f"audio is text, not a file: {HOW}, with the @")
            if audio is not None:
                raise InvalidOption("audio was given twice: send one recording per request")
            audio = value
        elif isinstance(value, str):
            fields.append((name, value))
        else:
            raise _misnamed_file(name[:60])
    if audio is None:
        raise MissingAudio(f"the form has no file field 'audio': {HOW}")
    return audio, fields


def _misnamed_file(name: str) -> DoaError:
    return InvalidOption(
        f"the form's file field is called {name!r}: only 'audio' is a file, options are text "
        "(curl -F 'array=<geometry.json' sends a file's content as text)"
    )
