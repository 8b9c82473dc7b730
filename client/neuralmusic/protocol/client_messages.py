"""A client's messages: ``start``, then ``update``, ``pose``, ``flush``, ``ping``, ``stop``."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Optional, Union

from pydantic import ConfigDict, Field, TypeAdapter, field_validator, model_validator
from typing_extensions import Self

from neuralmusic.protocol.framing import SAMPLE_BYTES, Encoding, HeaderKind
from neuralmusic.protocol.message import Message, message_type, read_message
from neuralmusic.protocol.methods import Hemisphere, Method
from neuralmusic.protocol.names import MAX_LABEL, NAME

Position = tuple[float, float, float]
Sector = tuple[float, float]
Include = Literal["spectrum", "sphere"]
OutputFormat = Literal["doa", "odas"]
Frame = Literal["robot", "world"]
MIN_INTERVAL_MS, MAX_INTERVAL_MS = 20, 1000
MIN_SAMPLE_RATE, MAX_SAMPLE_RATE = 4_000, 384_000


class AudioFormat(Message):
    """The format of the binary messages; there are no silent defaults."""

    encoding: Encoding
    """Little-endian samples, sample frames interleaved"""
    sample_rate: Annotated[int, Field(ge=MIN_SAMPLE_RATE, le=MAX_SAMPLE_RATE)]
    """Hertz at which the device records; the service resamples"""
    channels: Annotated[int, Field(ge=1, le=64)]
    """Channels in every sample frame, raw microphones and all others"""
    header: HeaderKind = "none"
    """`seq_time`: every binary message begins with 16 bytes (u32 flags, u32 sequence, i64 capture
    time in ns), so that lost messages are noticed and results carry the capture time"""

    @property
    def frame_bytes(self) -> int:
        """Bytes of one sample frame, all channels."""
        return SAMPLE_BYTES[self.encoding] * self.channels


class ArrayChoice(Message):
    """A preset by its name, or positions; one of the two is required."""

    name: Optional[Annotated[str, Field(min_length=1, max_length=MAX_LABEL)]] = None
    """A preset's name (`GET /arrays`), or any name beside `positions_m`; required without them"""
    positions_m: Optional[Annotated[list[Position], Field(min_length=2, max_length=64)]] = None
    """Metres, `[x, y, z]` per microphone: x forward, y left, z up"""
    channel_map: Optional[Annotated[list[int], Field(min_length=1, max_length=64)]] = None
    """Same as `start.channel_map`; give only one of the two"""


class OutputOptions(Message):
    """What results hold and how often they come; `update` changes it in flight."""

    interval_ms: Annotated[int, Field(ge=MIN_INTERVAL_MS, le=MAX_INTERVAL_MS)] = 100
    """Milliseconds of audio between results"""
    max_sources: Annotated[int, Field(ge=1, le=4)] = 3
    """Most sources in a result"""
    num_sources: Optional[Annotated[int, Field(ge=1, le=4)]] = None
    """The known number of sources, excluded ones included; null lets the service count"""
    include: tuple[Include, ...] = ()
    """`spectrum` adds 360 values of the spatial spectrum to every result, `sphere` an image of the
    sphere where the array tells elevations"""
    format: OutputFormat = "doa"
    """`odas` sends ODAS' SSL and SST objects (`ssl` and `sst`) instead of `result`"""
    yaw_deg: float = 0.0
    """Degrees by which the array is turned counter-clockwise on the robot, any finite angle;
    azimuths include it"""
    frame: Frame = "robot"
    """`robot`: directions as seen from where it is turned at `t_end`; `world`: in the frame of the
    poses, where those who stand still have one direction"""
    exclude_deg: Annotated[tuple[Sector, ...], Field(max_length=16)] = ()
    """Sectors `[from, to]` in degrees, counter-clockwise, after the yaw offset, in which nothing
    is reported: a loudspeaker, a wall, the robot's own motor"""

    @field_validator("exclude_deg")
    @classmethod
    def _check_sectors(cls, sectors: tuple[Sector, ...]) -> tuple[Sector, ...]:
        for first, last in sectors:
            if not (-360 <= first <= 360 and -360 <= last <= 360):
                raise ValueError("a sector is [from, to] in degrees from -360 to 360")
            if (last - first) % 360 == 0:
                raise ValueError(f"the sector [{first:g}, {last:g}] is empty or the whole circle")
        return sectors


def _without_defaults(schema: dict[str, Any]) -> None:
    for field in schema["properties"].values():
        field.pop("default", None)


class OutputUpdate(OutputOptions):
    """The output options to change; a field that is left out keeps its value."""

    model_config = ConfigDict(json_schema_extra=_without_defaults)


class Start(Message):
    """The first message of a session."""

    type: Literal["start"]
    audio: AudioFormat
    array: ArrayChoice
    channel_map: Optional[Annotated[list[int], Field(min_length=1, max_length=64)]] = None
    """The stream's channel of every microphone, from 0. Without it, one channel per microphone is
    taken as it is, and the channels of the preset's firmware are mapped by `raw_channels` of `GET
    /arrays`, with the warning `channel_map_assumed`"""
    model: Annotated[str, Field(min_length=1, max_length=64)] = "default"
    """A model's name (`GET /models`); `default` is the best one that fits the array"""
    method: Optional[Method] = None
    """Null is `neural` where a model fits the array, else `norm_music`"""
    hemisphere: Hemisphere = "both"
    """`upper` or `lower`: the side of the horizontal plane on which all sources are. A level array
    tells elevations only where it is known"""
    output: OutputOptions = OutputOptions()
    overflow: Literal["drop_oldest", "block"] = "drop_oldest"
    """What happens to audio that comes faster than it is localized: with `drop_oldest` results
    describe the present and a warning tells what was dropped; `block` loses nothing, for files"""
    client: Optional[Annotated[str, Field(pattern=NAME)]] = None
    """The robot's name, under which its noise calibration is stored"""
    noise: Literal["kept", "none"] = "kept"
    """`kept` whitens with the noise calibration stored for this client, if there is one"""


class Update(Message):
    """Change output options from the next result on; a field that is left out keeps its value."""

    type: Literal["update"]
    output: OutputUpdate


class Flush(Message):
    """Localize the buffered audio now; `flushed` follows, after a result where audio was left."""

    type: Literal["flush"]


class Ping(Message):
    """Ask for a `pong`; unlike a WebSocket ping, it keeps an idle session open."""

    type: Literal["ping"]
    id: Optional[Annotated[int, Field(ge=0, le=2**53)]] = None
    """Number that the `pong` repeats"""


class Calibrate(Message):
    """Learn the robot's own noise from the audio that follows; nobody may speak meanwhile.

    A second `calibrate` begins the first anew; a `stop` before the end discards it.
    """

    type: Literal["calibrate"]
    kind: Literal["noise"]
    seconds: Annotated[float, Field(ge=1, le=60)] = 5.0
    """Least seconds of audio; learning ends with the next result"""


class Pose(Message):
    """How the robot's head is turned at one moment; as often as it is known, 50 a second say.

    Angles turn from the world's frame about z (yaw, counter-clockwise), y (pitch, nose down) and x
    (roll), as ROS has them. Between poses the turn is interpolated; the first one holds before it,
    the last one after it.
    """

    type: Literal["pose"]
    t: Optional[float] = None
    """Seconds of audio since the session's start, as `t_end`; null with neither this nor
    `capture_time_ns`: the end of the audio sent so far"""
    capture_time_ns: Optional[Annotated[int, Field(ge=-(2**63), lt=2**63)]] = None
    """The same by the clock of the audio's `seq_time` headers"""
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    quaternion_xyzw: Optional[tuple[float, float, float, float]] = None
    """A rotation `[x, y, z, w]` of any length but 0, instead of the angles"""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.t is not None and self.capture_time_ns is not None:
            raise ValueError("a pose has t or capture_time_ns, not both")
        if self.quaternion_xyzw is not None:
            if self.model_fields_set & {"yaw_deg", "pitch_deg", "roll_deg"}:
                raise ValueError("a pose has angles or quaternion_xyzw, not both")
            if not 1e-6 < math.hypot(*self.quaternion_xyzw) < 1e6:
                raise ValueError("quaternion_xyzw is no rotation: its length should be 1")
        return self


class Stop(Message):
    """End the session: the last results, `summary` and close code 1000 follow."""

    type: Literal["stop"]


AnyClientMessage = Union[Start, Update, Flush, Ping, Calibrate, Pose, Stop]
CLIENT_MESSAGES: tuple[type[Message], ...] = (Start, Update, Flush, Ping, Calibrate, Pose, Stop)
_ADAPTER: TypeAdapter[AnyClientMessage] = TypeAdapter(
    Annotated[AnyClientMessage, Field(discriminator="type")]
)
_TYPES = [message_type(message) for message in CLIENT_MESSAGES]


def read_client_message(text: str | bytes) -> AnyClientMessage:
    """A client's message from its JSON, or InvalidMessage, which names the field."""
    return read_message(text, _ADAPTER, _TYPES)
