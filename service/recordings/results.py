"""Options and results of localizing a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa.array import MicrophoneArray
from service.doa.orientation import ALIGNED, Orientation
from service.doa.whitening import NoiseCovariance
from service.inference.results import AudioWarning, ModelIdentity, WindowEstimate

SHORTEST_WINDOW_S = 0.128
"""Seconds of the eight frames that the first covariance takes"""
DEFAULT_WINDOW_S = 1.024
DEFAULT_HOP_S = 0.512
DEFAULT_MAX_SOURCES = 3


@dataclass(frozen=True, slots=True)
class WindowResult:
    """A window's estimate with its place in the recording."""

    t_start: float
    """Seconds"""
    t_end: float
    """Seconds"""
    estimate: WindowEstimate


@dataclass(frozen=True, slots=True)
class SummarySource:
    """A direction that recurs over a recording."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    confidence: float
    """Mean confidence of its windows"""
    share: float
    """Share of the windows with any source in which this one is heard"""
    elevation: float | None = None
    """Radians above the horizontal plane; None where only azimuths are told"""


@dataclass(frozen=True, slots=True)
class LocalizeOptions:
    """How a recording is to be localized."""

    array: MicrophoneArray
    channel_map: tuple[int, ...] | None = None
    """Recording channel of every microphone, from 0; None takes the channels as they are"""
    model: str | None = None
    """Bundle name; None chooses by geometry"""
    method: Method | None = None
    """None is ``neural`` where a bundle fits the array, else ``norm_music``"""
    num_sources: int | None = None
    """Known number of sources; None estimates it"""
    max_sources: int = DEFAULT_MAX_SOURCES
    """Most sources where the number is estimated"""
    window_s: float = DEFAULT_WINDOW_S
    """Seconds per window"""
    hop_s: float = DEFAULT_HOP_S
    """Seconds between windows"""
    orientation: Orientation = ALIGNED
    """Mounting of the array, and sectors where nothing is reported"""
    noise: NoiseCovariance | None = None
    """The robot's own noise, to be removed"""
    hemisphere: Hemisphere = "both"
    """Side of the horizontal plane on which sources are"""
    spectrum: bool = False
    """Whether every window keeps its spatial spectrum; without it a window is a few numbers"""
    sphere: bool = False
    """Whether every window keeps its image of the sphere"""


@dataclass(frozen=True, slots=True)
class RecordingResult:
    """The answer for a whole recording."""

    method: Method
    model: ModelIdentity | None
    """Bundle that was used; None for a classical method"""
    sample_rate: int
    """Hertz of the recording as it was sent"""
    channels: int
    duration: float
    """Seconds"""
    array: MicrophoneArray
    channel_map: tuple[int, ...]
    windows: Sequence[WindowResult]
    summary: Sequence[SummarySource]
    warnings: Sequence[AudioWarning] = field(default_factory=tuple)
    stretches: Mapping[int, int] = field(default_factory=dict)
    """Counts by the number of windows that were computed at a time"""
    why_no_elevation: str | None = None
    """Reason why sources have azimuths only; None where they have elevations"""


def too_short(duration: float) -> list[AudioWarning]:
    """The warning about a recording of so many seconds that is too short to localize in."""
    if duration >= SHORTEST_WINDOW_S:
        return []
    detail = (
        f"the recording is {1000 * duration:.0f} ms long, and sources are counted in "
        f"{1000 * SHORTEST_WINDOW_S:g} ms and more: record at least half a second"
    )
    return [AudioWarning("too_short", detail)]
