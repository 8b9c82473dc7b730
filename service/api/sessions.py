"""``GET /sessions``: running streams, their live events, their results as a file."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack
from http import HTTPStatus
from typing import Annotated, Any, Literal

import anyio.to_thread
from fastapi import APIRouter, HTTPException, Query, Request
from pydantic import ValidationError
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from neuralmusic.errors import InvalidOption, Overloaded, TooManyWatchers
from neuralmusic.protocol.message import message_type
from neuralmusic.protocol.server_messages import Closing, ServerMessage, StreamError
from service.api.catalog import NOT_FOUND
from service.api.middleware.guard import key_of
from service.api.outbox import message_json
from service.api.problems import problem_responses
from service.api.replicas import ALONE, Reply
from service.api.session_answers import SessionsAnswer
from service.api.state import state_of
from service.lifecycle import Phase
from service.streaming.export import FORMATS, export_csv, export_json_lines
from service.streaming.registry import SessionEntry

KEEP_ALIVE_S = 15.0
"""Seconds of silence after which a comment is sent, so that proxies keep the connection open"""
MAX_EVENTS = 64
"""Most events queued for a slow watcher; older ones are left out"""
HISTORY_S = 60.0
"""Seconds of results that a new watcher gets"""

SESSION_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
PASSED_ON = ("content-type", "content-disposition", "cache-control", "retry-after")
"""Headers of another replica's answer that go on to the client"""
Asked = Annotated[
    Literal["all", "one"],
    Query(description="`one` asks only the replica that answers, `all` also those it knows"),
]

HistoryRow = tuple[float, float, int, float, bool, float | None]
"""``(t_end, azimuth_deg, id, confidence, active, elevation_deg)`` of one source"""

router = APIRouter(tags=["streams"])


class HoldingResponse(StreamingResponse):
    """A long answer that holds a watcher's place until it ends."""

    def __init__(self, content: AsyncIterator[str | bytes], place: ExitStack, **how: Any) -> None:
        super().__init__(content, **how)
        self._place = place

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._place:
            await super().__call__(scope, receive, send)


@router.get("/sessions", summary="List the streams", responses=problem_responses(InvalidOption))
async def sessions(request: Request, replicas: Asked = "all") -> SessionsAnswer:
    """Running streams, and ended ones whose results can still be exported.

    Where the service has several replicas and knows them, the streams of all.
    """
    state = state_of(request)
    own = SessionsAnswer.of(state)
    if replicas == "one" or not state.replicas.known:
        return own
    replies = await state.replicas.ask(request, f"/sessions?{ALONE}")
    return own.with_others([await _listed(reply) for reply in replies])


@router.get(
    "/sessions/{session_id}/events",
    summary="Watch a stream",
    response_class=StreamingResponse,
    responses={
        200: {
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
            "description": "Server-sent events: `ready`, `history` (the last minute), past "
            "warnings, then every message of the stream as it is sent; results always with their "
            "spectrum",
        },
        **NOT_FOUND,
        **problem_responses(TooManyWatchers, Overloaded, InvalidOption),
    },
)
async def session_events(
    request: Request, session_id: str, replicas: Asked = "all"
) -> StreamingResponse:
    """Every message that a running stream sends to its client, for dashboards."""
    state, key = state_of(request), key_of(request)
    entry = state.streams.get(session_id)
    if entry is None:
        return await _elsewhere(request, session_id, "events?", replicas)
    with ExitStack() as held:
        held.enter_context(state.streams.watcher())
        held.enter_context(state.keys.watcher(key))
        events = _events(entry, lambda: state.keys.holds(key, "watch"))
        headers = {"Cache-Control": "no-store"}
        return HoldingResponse(
            events, held.pop_all(), media_type="text/event-stream", headers=headers
        )


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
    replicas: Asked = "all",
) -> Response:
    """One line per result (JSON Lines) or per source of a result (CSV)."""
    entry = state_of(request).streams.get(session_id)
    if entry is None:
        return await _elsewhere(request, session_id, f"export?format={format}&", replicas)
    write = export_csv if format == "csv" else export_json_lines
    name = f"session-{entry.id}.{format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    history = tuple(entry.reporter.account.history)
    content = await anyio.to_thread.run_sync(write, history)
    return Response(content, media_type=FORMATS[format], headers=headers)


async def _listed(reply: Reply | None) -> SessionsAnswer | None:
    """A replica's own streams; None where it did not answer with them."""
    if reply is None:
        return None
    try:
        return SessionsAnswer.model_validate_json(await reply.whole())
    except (OSError, TimeoutError, ValidationError):
        return None
    finally:
        reply.close()


async def _elsewhere(
    request: Request, session_id: str, what: str, asked: Literal["all", "one"]
) -> HoldingResponse:
    """What the replica that has the session answers, as it comes."""
    state = state_of(request)
    if asked == "one" or not state.replicas.known or not SESSION_ID.fullmatch(session_id):
        raise HTTPException(HTTPStatus.NOT_FOUND)
    with ExitStack() as held:
        held.enter_context(state.streams.watcher())
        reply = await state.replicas.find(request, f"/sessions/{session_id}/{what}{ALONE}")
        if reply is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        held.callback(reply.close)
        return HoldingResponse(
            reply.pieces(lambda: not state.lifecycle.reached(Phase.DRAINING)),
            held.pop_all(),
            status_code=reply.status,
            headers={name: reply.headers[name] for name in PASSED_ON if name in reply.headers},
        )


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
    for warning in tuple(entry.warnings.values()):
        yield _event("warning", message_json(warning))
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


def _history(entry: SessionEntry) -> list[HistoryRow]:
    """Rows for every source of the last minute."""
    history = tuple(entry.reporter.account.history)
    since = history[-1].t_end - HISTORY_S if history else 0.0
    return [
        (
            result.t_end,
            point.azimuth_deg,
            point.id,
            point.confidence,
            point.active,
            point.elevation_deg,
        )
        for result in history
        if result.t_end >= since
        for point in result.points
    ]


def _event(kind: str, data: str) -> str:
    return f"event: {kind}\ndata: {data}\n\n"
