"""Messages of the server: each has a ``type`` and a ``seq`` that counts from 0."""

from __future__ import annotations

from typing import Annotated, Literal, Optional, Union

from pydantic import ConfigDict, Field, TypeAdapter

from neuralmusic.protocol.message import Message, message_type, read_message
from neuralmusic.protocol.methods import Method

WarningCode = Literal[
    "audio_dropped",
    "audio_gap",
    "non_finite",
    "quiet",
    "channel_dead",
    "channels_identical",
    "clipping",
    "dc_offset",
    "band_limited",
    "channel_late",
    "channel_inverted",
    "channel_order",
    "array_scale",
    "channel_processed",
    "sample_rate_wrong",
    "channel_map_assumed",
    "no_model_for_array",
    "front_back_ambiguous",
    "noise_mismatch",
    "calibration_failed",
    "length_unknown",
    "pose_stale",
    "too_short",
]
WhyNoSource = Literal["silence", "no_direction", "unconfirmed", "excluded", "warming_up"]


class Part(Message):
    """A part of a server's message; a newer server may send fields that this client ignores."""

    model_config = ConfigDict(extra="ignore")


class ServerMessage(Part):
    """Any message of the server."""

    seq: int
    """Number of the message in the session, from 0; a missing number is a result that was dropped
    because the client did not read"""


class StreamModel(Part):
    """The bundle in use."""

    name: str
    version: str
    variant: str
    sha256: str
    """Hash of its `bundle.json`"""


class StreamArray(Part):
    """The array in use."""

    name: str
    positions_m: list[list[float]]
    """Metres, `[x, y, z]` per microphone: x forward, y left, z up"""
    why_no_elevation: Optional[str] = None
    """Why `elevation_deg` is null; null where elevations are told"""


class Timing(Part):
    """When results come."""

    interval_ms: int
    window_ms: float
    """Milliseconds of audio behind a result"""
    algorithmic_latency_ms: float
    """Mean milliseconds of audio after an event's beginning before a result can hold it: half an
    interval and one complete frame"""
    sample_rate: int
    """Hertz to which the stream is resampled"""


class Limits(Part):
    """Limits of the session."""

    max_message_bytes: int
    buffer_ms: int
    """Most milliseconds of audio that wait, `interval_ms` included; older audio is dropped. An
    `update` of `interval_ms` changes it by as much"""
    idle_timeout_s: float
    """Seconds without any binary or text message after which the session ends"""
    max_session_s: float
    """Longest session in seconds"""


class NoiseInUse(Part):
    """The noise calibration that whitens the audio."""

    name: str
    """The client's name"""
    seconds: float
    """Seconds of noise behind the calibration"""


class Ready(ServerMessage):
    """The answer to `start`: what is in effect."""

    type: Literal["ready"] = "ready"
    session: str
    """Id of the session, as in `GET /sessions`"""
    model: Optional[StreamModel]
    """The bundle in use; null with a classical method"""
    method: Method
    array: StreamArray
    channel_map: list[int]
    """The stream's channel of every microphone, from 0"""
    convention: str
    """Convention of azimuths in words"""
    timing: Timing
    limits: Limits
    noise: Optional[NoiseInUse] = None


class StreamSource(Part):
    """One tracked source."""

    id: int
    """Identity of the source; it has it again after up to 12 s of silence, nobody else ever does"""
    azimuth_deg: float
    """Degrees in [0, 360), counter-clockwise from +x of `output.frame`, yaw offset included"""
    elevation_deg: Optional[float] = None
    """Degrees from -90 to 90 above the array's horizontal plane; null where the array or the method
    tells azimuths only, as `array.why_no_elevation` says"""
    unit_vector: list[float]
    """`[x, y, z]` towards the source in the same frame; z = 0 without an elevation"""
    confidence: float
    """0 to 1: the chance that a source is within 10 degrees of there"""
    active: bool
    """False while the source pauses and its track coasts"""
    velocity_deg_s: float
    """Degrees per second, counter-clockwise: the source's own, without the turns of the poses"""
    std_deg: float
    """Standard deviation of the direction in degrees"""


class PoseInUse(Part):
    """How the robot was turned at a result's `t_end`, by its poses."""

    yaw_deg: float
    """Degrees, counter-clockwise"""
    pitch_deg: float
    """Degrees, positive: nose down"""
    roll_deg: float
    """Degrees"""


class Result(ServerMessage):
    """The directions of sound at present."""

    type: Literal["result"] = "result"
    session: Optional[str] = None
    """Id of the session, as in `ready`"""
    t_start: float
    """Seconds of audio from the session's start to the window's beginning"""
    t_end: float
    """Seconds of audio from the session's start to the window's end"""
    capture_time_ns: Optional[int] = None
    """Capture time of `t_end`; null where the audio has no `seq_time` headers"""
    sources: list[StreamSource]
    """Most confident first; empty in silence"""
    why_no_source: Optional[WhyNoSource] = None
    """Why `sources` is empty; null where it is not"""
    spectrum: Optional[list[float]] = None
    """Spatial spectrum at 0, 1, ... 359 degrees, yaw offset included, at most 1; absent, not null,
    unless `include` names it"""
    pose: Optional[PoseInUse] = None
    """The robot's pose at `t_end`; absent, not null, where no pose was sent"""
    sphere: Optional[list[list[float]]] = None
    """Spatial spectrum on the sphere, at most 1: 36 rows at the elevations -87.5, -82.5, ... 87.5
    degrees, each with 72 values at the azimuths 0, 5, ... 355, yaw offset included; 0 where the
    array is not searched. Absent, not null, unless `include` names it and the array tells
    elevations (`ready.array.why_no_elevation`)"""
    lag_ms: float
    """Milliseconds between the arrival of the window's last audio and this result"""
    final: bool = False
    """True for a result that `flush` or `stop` gave before it was due. There is none where no audio
    was left: wait for `flushed` or `summary`"""


class OdasPotential(Part):
    """One direction of ODAS' sound source localization."""

    x: float
    y: float
    z: float
    E: float
    """Height of the peak, 0 to 1"""


class OdasSource(Part):
    """One track of ODAS' sound source tracking; id 0 is an empty place."""

    id: int
    tag: Literal["dynamic", ""]
    x: float
    y: float
    z: float
    activity: float
    """Activity of the source, 0 to 1"""


class OdasSsl(ServerMessage):
    """ODAS' SSL object, four directions, instead of a result."""

    type: Literal["ssl"] = "ssl"
    session: Optional[str] = None
    """Id of the session, as in `ready`"""
    timeStamp: int
    """Counts ODAS' hops of 8 ms"""
    src: list[OdasPotential]


class OdasSst(ServerMessage):
    """ODAS' SST object, four tracks, instead of a result."""

    type: Literal["sst"] = "sst"
    session: Optional[str] = None
    """Id of the session, as in `ready`"""
    timeStamp: int
    """Counts ODAS' hops of 8 ms"""
    src: list[OdasSource]


class StreamWarning(ServerMessage):
    """Something that the robot's developer should know; the session continues."""

    type: Literal["warning"] = "warning"
    code: WarningCode
    detail: str
    """What happened, and what to do"""
    channels: tuple[int, ...] = ()
    """Channels of the stream that are concerned"""
    duration_ms: Optional[float] = None
    """Milliseconds of dropped audio since the last `audio_dropped`, or of missing audio"""


class Stats(ServerMessage):
    """Figures of the session so far, every 5 s of audio."""

    type: Literal["stats"] = "stats"
    audio_s: float
    """Seconds of audio received, dropped audio included, gaps excluded"""
    results: int
    """Number of results, those included that the client did not read in time"""
    dropped_s: float
    """Seconds of audio dropped because the server or the network was too slow: the total"""
    gap_s: float
    """Seconds of audio missing by the sequence numbers and capture times"""
    results_dropped: int
    """Results and `stats` that the client did not read in time"""
    lag_ms: float
    """Mean lag of the results since the last `stats`"""
    buffered_ms: float
    """Milliseconds of waiting audio"""


class Flushed(ServerMessage):
    """Everything sent before `flush` has been localized."""

    type: Literal["flushed"] = "flushed"
    t_end: float
    """Seconds of audio from the session's start to the last result's end"""


class Pong(ServerMessage):
    """The answer to `ping`."""

    type: Literal["pong"] = "pong"
    id: Optional[int] = None
    """Number of the `ping`; null where it had none"""


class Calibrated(ServerMessage):
    """The noise was learnt and whitens the audio from now on."""

    type: Literal["calibrated"] = "calibrated"
    kind: Literal["noise"] = "noise"
    name: Optional[str]
    """Client's name under which the calibration is stored (`GET /noise/{name}`); null where `start`
    names no client: the calibration then ends with the session"""
    seconds: float
    """Seconds of noise learnt"""


class StreamError(ServerMessage):
    """Why the session ends; the close frame follows."""

    type: Literal["error"] = "error"
    code: str
    """Stable identifier for programs, such as `message_invalid`"""
    title: str
    detail: str
    """What happened, and what to do"""
    retryable: bool
    """True where the same session may succeed later"""
    close_code: int


class Closing(ServerMessage):
    """The server ends the session without an error; the close frame follows."""

    type: Literal["closing"] = "closing"
    code: str
    """`done` or `draining`; watchers of a session get `vanished` when its client is gone"""
    detail: str
    close_code: int


class TrackSummary(Part):
    """One source over the session."""

    id: int
    azimuth_deg: float
    """Last azimuth in degrees"""
    first_s: float
    """Seconds of audio from the session's start"""
    last_s: float
    active_s: float
    """Seconds of audio in which the source was heard"""


class Summary(ServerMessage):
    """The session as a whole, after `stop` and before the server's own end."""

    type: Literal["summary"] = "summary"
    audio_s: float
    """Seconds of audio received, dropped audio included, gaps excluded"""
    results: int
    """Number of results, those included that the client did not read in time"""
    dropped_s: float
    """Seconds of audio dropped because the server or the network was too slow: the total"""
    gap_s: float
    """Seconds of audio missing by the sequence numbers and capture times"""
    sources: list[TrackSummary]
    """The last 256 sources, longest heard first"""
    warnings: dict[str, int]
    """Count of every warning by code"""


SERVER_MESSAGES: tuple[type[ServerMessage], ...] = (
    Ready,
    Result,
    OdasSsl,
    OdasSst,
    StreamWarning,
    Stats,
    Flushed,
    Pong,
    Calibrated,
    StreamError,
    Closing,
    Summary,
)
ODAS_HOP_S = 0.008
"""Seconds of a hop, the unit of ODAS' ``timeStamp``"""
RESULTS = (Result, OdasSsl, OdasSst)
"""Messages with directions; old ones are dropped for a client that reads too slowly"""
AnyServerMessage = Union[
    Ready,
    Result,
    OdasSsl,
    OdasSst,
    StreamWarning,
    Stats,
    Flushed,
    Pong,
    Calibrated,
    StreamError,
    Closing,
    Summary,
]
_ADAPTER: TypeAdapter[AnyServerMessage] = TypeAdapter(
    Annotated[AnyServerMessage, Field(discriminator="type")]
)
_TYPES = [message_type(message) for message in SERVER_MESSAGES]


def read_server_message(text: str | bytes) -> AnyServerMessage:
    """A server's message from its JSON, for clients; raises InvalidMessage."""
    return read_message(text, _ADAPTER, _TYPES)
