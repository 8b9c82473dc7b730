"""Which web pages may open streams: a browser sends the page's origin, robots send none."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from service.errors import OriginRefused


def check_origin(headers: Headers, allowed: Sequence[str]) -> None:
    """Raise OriginRefused unless the page is the service's own or on the list.

    Browsers let any page open a WebSocket to any host, so that without this check every page that
    somebody in the robot's network visits could use the robot's service.
    """
    origin = headers.get("origin")
    if origin is None or "*" in allowed or origin in allowed:
        return
    if urlsplit(origin).netloc == headers.get("host"):
        return
    raise OriginRefused(
        f"pages of {origin[:100]} may not open streams: add the origin to NEURALMUSIC_ORIGINS"
    )
