"""One recording to localize: the job, reports of its progress, and the outcome."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import BinaryIO

from neuralmusic.errors import DoaError, InvalidOption
from service.audio.recording import AudioLimits, Recording
from service.inference.registry import BundleRegistry
from service.recordings.answer_json import localization_json
from service.recordings.localize import localize_recording
from service.recordings.options import LocalizeRequest
from service.recordings.results import LocalizeOptions

MAX_WINDOWS = 50_000
"""Most windows in one answer"""
MAX_SPECTRUM_WINDOWS = 10_000
"""Most windows in one answer with spectra: 360 numbers for every window"""

MAX_SPHERE_WINDOWS = 1_500
"""Most windows in one answer with images of the sphere: 2,592 numbers for every window"""


@dataclass(frozen=True, slots=True)
class RecordingJob:
    """The job without the recording's file."""

    asked: LocalizeRequest
    """The request; its options hold the noise profile itself"""
    limits: AudioLimits
    request_id: str | None = None
    """Id of the request, for the log"""


@dataclass(frozen=True, slots=True)
class HeaderRead:
    """The header is valid; nothing is decoded yet."""

    duration: float
    """Length in seconds"""


@dataclass(frozen=True, slots=True)
class Progress:
    """The share of the recording that is done, 0 to 1."""

    share: float


@dataclass(frozen=True, slots=True)
class Localized:
    """The answer."""

    body: bytes
    """JSON in UTF-8"""
    stretches: Mapping[int, int]
    """Counts by the number of windows that were computed at a time"""
    seconds: float
    """Seconds the worker took"""


@dataclass(frozen=True, slots=True)
class Refused:
    """The recording could not be localized."""

    error: DoaError


Report = HeaderRead | Progress
Outcome = Localized | Refused


def localize_file(
    job: RecordingJob,
    file: BinaryIO,
    registry: BundleRegistry,
    report: Callable[[Report], None],
    processes: int = 1,
) -> tuple[bytes, Mapping[int, int]]:
    """The answer's JSON, and counts by the number of windows that were computed at a time.

    Raises
    ------
    DoaError
        If the recording or the options cannot be used.
    WorkerLost
        If one of the processes was killed.
    """
    options = job.asked.options
    with Recording.open(file, job.limits) as recording:
        _check_windows(recording.duration, options)
        report(HeaderRead(recording.duration))
        result = localize_recording(
            recording,
            options,
            registry,
            lambda share: report(Progress(share)),
            processes=processes,
        )
    return localization_json(result), result.stretches


def _check_windows(duration: float, options: LocalizeOptions) -> None:
    hop = options.hop_s
    count = int(duration / hop) + 1
    most = MAX_SPECTRUM_WINDOWS if options.spectrum else MAX_WINDOWS
    if options.sphere:
        most = MAX_SPHERE_WINDOWS
    if count > most:
        spectra = " with spectra" if options.spectrum or options.sphere else ""
        least = math.ceil(1000 * duration / (most - 1)) / 1000
        raise InvalidOption(
            f"{duration:.0f} s at hop_s={hop:g} are {count} windows, one answer has at most "
            f"{most}{spectra}: use hop_s={least:g} or more, or split the recording"
        )
