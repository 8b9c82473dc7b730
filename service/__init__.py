"""NeuralMUSIC Service: sound source localization for robots.

``localize`` localizes a recording in this process, without a server.
"""

from __future__ import annotations

import typing

if typing.TYPE_CHECKING:
    from service.in_process import localize

__all__ = ["localize"]


def __getattr__(name: str) -> typing.Any:
    """``localize``, once it is asked for."""
    if name != "localize":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from service.in_process import localize

    return localize
