"""Jobs of a session for its worker process, and their outcomes; all can be pickled.

A session lives on the event loop, its pipeline in a worker process. In threads of one process,
numpy's many small operations would spend as long on the interpreter's lock as on work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from neuralmusic.errors import DoaError
from neuralmusic.protocol.client_messages import OutputOptions, Start
from neuralmusic.protocol.methods import Method
from neuralmusic.protocol.server_messages import StreamArray, StreamModel
from service.doa.diagnostics import Finding
from service.doa.pose import Pose
from service.doa.whitening import NoiseCovariance
from service.inference.results import AudioWarning
from service.streaming.buffer import Piece
from service.streaming.clock import StreamClock
from service.streaming.pipeline import Estimate


@dataclass(frozen=True, slots=True)
class Open:
    """Build the pipeline of a ``start``."""

    session: str
    start: Start
    noise: NoiseCovariance | None = None
    """The calibration stored for the client"""


class Advance(NamedTuple):
    """Take in audio up to the next result."""

    session: str
    pieces: Sequence[Piece]
    output: OutputOptions
    final: bool = False
    """Whether to give a result now, due or not"""
    calibrate_s: float | None = None
    """Seconds for which to learn the noise, beginning with this audio"""
    poses: Sequence[Pose] = ()
    """The robot's poses that came since the last job"""


@dataclass(frozen=True, slots=True)
class Check:
    """Check the channels."""

    session: str


@dataclass(frozen=True, slots=True)
class Close:
    """Forget the pipeline; nothing comes back."""

    session: str


Work = Open | Advance | Check | Close


@dataclass(frozen=True, slots=True)
class Keep:
    """Store the noise that a client's stream has learnt; no job of the worker's."""

    name: str
    noise: NoiseCovariance


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A pipeline is ready; what it works with."""

    model: StreamModel | None
    method: Method
    array: StreamArray
    channel_map: tuple[int, ...]
    sample_rate: int
    """Sample rate of the analysis in hertz"""
    frame_s: float
    """Seconds of an STFT frame"""
    window_s: float
    """Most seconds of audio behind a result"""
    noise_s: float | None
    """Seconds of noise behind the calibration in use"""
    warnings: tuple[AudioWarning, ...]
    clock: StreamClock


class Advanced(NamedTuple):
    """The outcome of one step."""

    clock: StreamClock
    estimate: Estimate | None
    """The estimate, where one was due"""
    check_due: bool
    calibrated: NoiseCovariance | None = None
    """The learnt noise, in the step that completes the calibration"""
    calibration_error: str | None = None


@dataclass(frozen=True, slots=True)
class Checked:
    """New findings about the channels."""

    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class Kept:
    """The noise was stored."""

    error: str | None = None
    """Why it was not"""


@dataclass(frozen=True, slots=True)
class Failed:
    """The job failed."""

    error: DoaError


Outcome = StreamOpened | Advanced | Checked | Kept | Failed

Answer = tuple[int, Outcome, float]
"""Answer of a worker: the job's number, its outcome, the seconds it took"""
