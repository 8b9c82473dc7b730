"""One fault of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

FindingCode = Literal[
    "non_finite",
    "quiet",
    "channel_dead",
    "channels_identical",
    "channel_processed",
    "clipping",
    "dc_offset",
    "band_limited",
    "channel_late",
    "channel_inverted",
    "channel_order",
    "array_scale",
    "sample_rate_wrong",
]


@dataclass(frozen=True, slots=True)
class Finding:
    """A stable code, a sentence that says what to do, and the channels concerned."""

    code: FindingCode
    detail: str
    channels: tuple[int, ...] = ()
    """Recording channels from 0; empty for the whole recording"""


def channel_list(channels: Sequence[int]) -> str:
    """``channel 2`` or ``channels 0, 1 and 3``."""
    names = [str(channel) for channel in channels]
    if len(names) == 1:
        return f"channel {names[0]}"
    return f"channels {', '.join(names[:-1])} and {names[-1]}"


def is_or_are(channels: Sequence[int]) -> str:
    """The verb for ``channel_list``."""
    return "is" if len(channels) == 1 else "are"
