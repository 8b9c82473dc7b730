"""What a session has computed elsewhere, and what comes back; everything can be pickled.

A session lives on the event loop, its pipeline in a worker process: numpy's many small operations
in threads of one process would spend as long on handing the interpreter's lock around as on work.
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
    noise: NoiseCovariance | None
    """The calibration kept for the client"""


class Advance(NamedTuple):
    """Take in audio up to the next result."""

    session: str
    pieces: Sequence[Piece]
    output: OutputOptions
    final: bool = False
    """A result of what is there, due or not"""
    calibrate_s: float | None = None
    """Begin to learn the noise with this audio, for so many seconds"""


@dataclass(frozen=True, slots=True)
class Check:
    """Look at the channels."""

    session: str


@dataclass(frozen=True, slots=True)
class Close:
    """Forget the pipeline; nothing comes back."""

    session: str


Work = Open | Advance | Check | Close


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A pipeline that is ready, and what it works with."""

    model: StreamModel | None
    method: Method
    array: StreamArray
    channel_map: tuple[int, ...]
    sample_rate: int
    """Hertz, of the analysis"""
    frame_s: float
    """Seconds of an STFT frame"""
    window_s: float
    """Seconds that a result looks back on at most"""
    noise_s: float | None
    """Seconds of noise that the calibration in use was learnt from"""
    warnings: tuple[AudioWarning, ...]
    clock: StreamClock


class Advanced(NamedTuple):
    """What one step gave."""

    clock: StreamClock
    estimate: Estimate | None
    """None where none was due"""
    check_due: bool
    calibrated: NoiseCovariance | None = None
    """The noise, in the step that completed its calibration"""
    calibration_error: str | None = None


@dataclass(frozen=True, slots=True)
class Checked:
    """What is wrong with the channels and was not said before."""

    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class Failed:
    """The work could not be done."""

    error: DoaError


Outcome = StreamOpened | Advanced | Checked | Failed

Answer = tuple[int, Outcome, float]
"""What a worker sends back: the work's number, what came of it, the seconds that it took"""
