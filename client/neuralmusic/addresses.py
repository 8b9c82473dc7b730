"""The service's addresses, from any form that a user gives."""

from __future__ import annotations

from urllib.parse import urlsplit, urlunsplit

from neuralmusic.errors import InvalidOption

STREAM_PATH = "/stream"
_PLAIN = {"http": "http", "ws": "http", "https": "https", "wss": "https"}
_SOCKET = {"http": "ws", "https": "wss"}


def service_url(url: str) -> str:
    """``http(s)://host[:port][/prefix]``, without ``/stream`` and without a slash at the end.

    Parameters
    ----------
    url : str
        An address with ``http``, ``https``, ``ws`` or ``wss``; without one it means ``http``.

    Raises
    ------
    InvalidOption
        If it is not such an address, or has a query: keys never belong in an address.
    """
    text = url.strip()
    try:
        parts = urlsplit(text if "://" in text else f"http://{text}")
        known = parts.scheme in _PLAIN and bool(parts.hostname) and parts.port != 0
    except ValueError:  # an impossible port or bracket
        known = False
    if not known:
        raise InvalidOption(f"{url!r} is not an address: give one such as http://127.0.0.1:8000")
    if parts.query or parts.fragment or parts.username is not None:
        raise InvalidOption(
            f"the address of {parts.hostname} may hold neither a query nor a user name: give a key "
            "as key, never in an address"
        )
    path = parts.path.rstrip("/").removesuffix(STREAM_PATH)
    return urlunsplit((_PLAIN[parts.scheme], parts.netloc, path, "", ""))


def stream_url(url: str) -> str:
    """``ws(s)://host[:port][/prefix]/stream``, from the same forms as ``service_url``."""
    scheme, rest = service_url(url).split("://", 1)
    return f"{_SOCKET[scheme]}://{rest}{STREAM_PATH}"


def authorization(key: str | None) -> dict[str, str]:
    """The header with a key, if there is one; InvalidOption where it cannot be a key."""
    if not key:
        return {}
    if not (key.strip().isascii() and key.strip().isprintable()):
        raise InvalidOption("the key has characters that no key has: pass it as it was printed")
    return {"Authorization": f"Bearer {key.strip()}"}
