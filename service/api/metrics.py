"""``GET /metrics``: what Prometheus scrapes."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api.state import state_of

router = APIRouter(tags=["service"])

TEXT = {"schema": {"type": "string"}}


@router.get(
    "/metrics",
    summary="Metrics for Prometheus",
    response_class=Response,
    responses={
        200: {
            "description": "Counters, gauges and histograms as text (docs/monitoring.md)",
            "content": {"text/plain": TEXT, "application/openmetrics-text": TEXT},
        }
    },
)
async def metrics(request: Request) -> Response:
    """All metrics, in the text format 0.0.4, or as OpenMetrics where `Accept` asks for it."""
    body, media_type = state_of(request).metrics.exposition(request.headers.get("accept", ""))
    return Response(body, headers={"Content-Type": media_type, "Cache-Control": "no-store"})
