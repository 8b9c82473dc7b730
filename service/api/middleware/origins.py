"""Web pages that may use the service: a browser sends the page's origin, robots send none."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from neuralmusic.errors import OriginRefused

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing; pages of other origins cannot read their answers"""


def check_origin(headers: Headers, allowed: Sequence[str]) -> None:
    """Raise OriginRefused unless the page is the service's own or on the list.

    Browsers let any page open a WebSocket to any host and post a form there. Without this check
    every page that somebody in the robot's network visits could use the robot's service.
    """
    origin = headers.get("origin")
    # People write a slash at the end; browsers send none.
    if origin is None or "*" in allowed or origin in (each.rstrip("/") for each in allowed):
        return
    place = _place(origin)
    if place and place == headers.get("host"):
        return
    raise OriginRefused(
        f"pages of {origin[:100]} may not use this service: use its own page, or ask whoever "
        "runs it to add the origin to NEURALMUSIC_ORIGINS"
    )


def _place(origin: str) -> str:
    """Host and port of an origin; empty where it has none, as ``null`` has."""
    try:
        return urlsplit(origin).netloc
    except ValueError:  # a bracket that does not close
        return ""
