"""``GET /sessions``: running streams, their live events, their results as a file."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack
from http import HTTPStatus
from typing import Annotated, Literal

import anyio.to_thread
from fastapi import APIRouter, HTTPException, Query, Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from neuralmusic.errors import InvalidOption, Overloaded, TooManyWatchers
from neuralmusic.protocol.message import message_type
from neuralmusic.protocol.methods import Method
from neuralmusic.protocol.server_messages import Closing, ServerMessage, StreamError
from service.api.catalog import NOT_FOUND
from service.api.middleware.guard import key_of
from service.api.outbox import message_json
from service.api.problems import problem_responses
from service.api.state import state_of
from service.recordings.answers import Answer
from service.streaming.export import FORMATS, export_csv, export_json_lines
from service.streaming.registry import SessionEntry

KEEP_ALIVE_S = 15.0
"""Seconds of silence after which a comment is sent, so that proxies keep the connection open"""
MAX_EVENTS = 64
"""Most events queued for a slow watcher; older ones are left out"""
HISTORY_S = 60.0
"""Seconds of results that a new watcher gets"""

router = APIRouter(tags=["streams"])


class SessionAnswer(Answer):
    """One stream."""

    id: str
    client: str | None
    """Name that the client gave itself"""
    array: str | None
    """Name of the array; null until `start` was received"""
    model: str | None
    method: Method | None
    started_at: str
    """Time at which the stream began: ISO 8601, UTC"""
    audio_s: float
    """Seconds of audio received"""
    results: int
    lag_ms: float
    """Milliseconds from audio to result, of the last result"""
    dropped_s: float
    """Seconds of audio dropped so that results describe the present"""
    num_sources: int
    """Number of sources in the last result"""
    state: Literal["running", "ended"]

    @classmethod
    def of(cls, entry: SessionEntry) -> SessionAnswer:
        ready, account = entry.ready, entry.reporter.account
        last = account.history.last
        return cls(
            id=entry.id,
            client=entry.client,
            array=ready.array.name if ready else None,
            model=ready.model.name if ready and ready.model else None,
            method=ready.method if ready else None,
            started_at=entry.started_at.isoformat(timespec="milliseconds"),
            audio_s=round(account.audio_s, 3),
            results=account.results,
            lag_ms=account.lag_ms,
            dropped_s=round(account.dropped_s, 3),
            num_sources=len(last.points) if last else 0,
            state="running" if entry.running else "ended",
        )


class SessionsAnswer(Answer):
    """The streams of this process."""

    sessions: list[SessionAnswer]
    """Running streams first, then the last that ended"""
    max_sessions: int
    """Most streams that may run at the same time"""


class EventStream(StreamingResponse):
    """Server-sent events, which hold a watcher's place until they end."""

    def __init__(self, events: AsyncIterator[str], place: ExitStack) -> None:
        headers = {"Cache-Control": "no-store"}
        super().__init__(events, media_type="text/event-stream", headers=headers)
        self._place = place

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._place:
            await super().__call__(scope, receive, send)


@router.get("/sessions", summary="List the streams")
async def sessions(request: Request) -> SessionsAnswer:
    """Running streams, and ended ones whose results can still be exported."""
    streams = state_of(request).streams
    return SessionsAnswer(
        sessions=[SessionAnswer.of(entry) for entry in streams], max_sessions=streams.max_sessions
    )


@router.get(
    "/sessions/{session_id}/events",
    summary="Watch a stream",
    response_class=StreamingResponse,
    responses={
        200: {
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
            "description": "Server-sent events: `ready`, `history` (the last minute), then every "
            "message of the stream as it is sent; results always with their spectrum",
        },
        **NOT_FOUND,
        **problem_responses(TooManyWatchers, Overloaded),
    },
)
async def session_events(request: Request, session_id: str) -> StreamingResponse:
    """Every message that a running stream sends to its client, for dashboards."""
    entry = _entry(request, session_id)
    state, key = state_of(request), key_of(request)
    with ExitStack() as held:
        held.enter_context(state.streams.watcher())
        held.enter_context(state.keys.watcher(key))
        events = _events(entry, lambda: state.keys.holds(key, "watch"))
        return EventStream(events, held.pop_all())


@router.get(
    "/sessions/{session_id}/export",
    summary="Download a stream's results",
    response_class=Response,
    responses={
        200: {
            "content": {
                "application/jsonl": {"schema": {"type": "string"}},
                "text/csv": {"schema": {"type": "string"}},
            },
            "description": "The last ten minutes at ten results a second",
        },
        **NOT_FOUND,
        **problem_responses(InvalidOption),
    },
)
async def session_export(
    request: Request,
    session_id: str,
    format: Annotated[Literal["jsonl", "csv"], Query(description="JSON Lines or CSV")] = "jsonl",
) -> Response:
    """One line per result (JSON Lines) or per source of a result (CSV)."""
    entry = _entry(request, session_id)
    write = export_csv if format == "csv" else export_json_lines
    name = f"session-{entry.id}.{format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    history = tuple(entry.reporter.account.history)
    content = await anyio.to_thread.run_sync(write, history)
    return Response(content, media_type=FORMATS[format], headers=headers)


def _entry(request: Request, session_id: str) -> SessionEntry:
    entry = state_of(request).streams.get(session_id)
    if entry is None:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    return entry


async def _events(entry: SessionEntry, allowed: Callable[[], bool]) -> AsyncIterator[str]:
    """Server-sent events of one session until it ends or the watcher's key no longer allows it."""
    waiting: asyncio.Queue[ServerMessage] = asyncio.Queue(MAX_EVENTS)

    def watch(message: ServerMessage) -> None:
        if waiting.full():
            waiting.get_nowait()
        waiting.put_nowait(message)

    if entry.ready is not None:
        yield _event("ready", message_json(entry.ready))
    yield _event("history", json.dumps({"points": _history(entry)}))
    if not entry.running:
        return
    entry.watch(watch)
    try:
        while allowed():
            try:
                message = await asyncio.wait_for(waiting.get(), KEEP_ALIVE_S)
            except TimeoutError:
                if not entry.running:
                    return
                yield ": still here\n\n"
                continue
            yield _event(message_type(type(message)), message_json(message))
            if isinstance(message, Closing | StreamError):
                return
    finally:
        entry.unwatch(watch)


def _history(entry: SessionEntry) -> list[tuple[float, float, int, float, bool]]:
    """``[t_end, azimuth_deg, id, confidence, active]`` for every source of the last minute."""
    history = tuple(entry.reporter.account.history)
    since = history[-1].t_end - HISTORY_S if history else 0.0
    return [
        (result.t_end, point.azimuth_deg, point.id, point.confidence, point.active)
        for result in history
        if result.t_end >= since
        for point in result.points
    ]


def _event(kind: str, data: str) -> str:
    return f"event: {kind}\ndata: {data}\n\n"
