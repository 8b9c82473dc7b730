"""The part of both stream clients that never waits: state, and messages to the service."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from neuralmusic.addresses import stream_url
from neuralmusic.protocol.client_messages import (
    ArrayChoice,
    AudioFormat,
    Calibrate,
    Flush,
    Frame,
    Include,
    OutputFormat,
    OutputOptions,
    OutputUpdate,
    Ping,
    Start,
    Update,
    read_client_message,
)
from neuralmusic.protocol.methods import Hemisphere, Method
from neuralmusic.protocol.server_messages import Ready, Result, Summary
from neuralmusic.streams.backoff import Backoff
from neuralmusic.streams.connection import Timeouts
from neuralmusic.streams.inbox import StreamEvent
from neuralmusic.streams.sessions import Sessions, StreamOptions
from neuralmusic.streams.start import UNCHANGED, Unchanged, read_start


class StreamControls:
    """A stream that reconnects, without opening, sending, receiving and closing."""

    def __init__(
        self,
        url: str,
        start: Start | None = None,
        *,
        audio: AudioFormat | Mapping[str, Any] | None = None,
        array: str | ArrayChoice | Mapping[str, Any] | None = None,
        channel_map: Sequence[int] | None = None,
        model: str | None = None,
        method: Method | None = None,
        output: OutputOptions | Mapping[str, Any] | None = None,
        overflow: Literal["drop_oldest", "block"] | None = None,
        client: str | None = None,
        noise: Literal["kept", "none"] | None = None,
        hemisphere: Hemisphere | None = None,
        key: str | None = None,
        reconnect: bool | None = None,
        wait_s: float = 0.0,
        queue_s: float = 0.5,
        max_unread: int | None = None,
        backoff: Backoff | None = None,
        timeouts: Timeouts | None = None,
    ) -> None:
        """Prepare a stream; nothing is connected yet.

        Parameters
        ----------
        url : str
            ``http(s)://`` or ``ws(s)://``, with or without ``/stream``.
        start : Start, optional
            The first message, instead of the fields from ``audio`` to ``hemisphere``.
        audio : AudioFormat or mapping
            Format of the audio: ``{"encoding": "pcm_s16le", "sample_rate": 16000,
            "channels": 4}``.
        array : str, ArrayChoice or mapping
            A preset's name, or ``{"positions_m": [[x, y, z], ...]}`` in metres.
        channel_map : sequence of int, optional
            The stream's channel of every microphone, from 0.
        model : str, optional
            A model's name; by default the first that fits the array.
        method : str, optional
            ``neural``, ``norm_music``, ``music``, ``srp_phat`` or ``gcc_phat``; by default
            ``neural`` where a model fits the array, else ``norm_music``.
        output : OutputOptions or mapping, optional
            Content and rate of results: ``{"interval_ms": 200, "yaw_deg": 90}``.
        overflow : str, optional
            What happens to audio that comes faster than it is localized: with ``drop_oldest``, the
            default, results describe the present; ``block`` loses nothing, for files.
        client : str, optional
            The robot's name, under which its noise calibration is stored.
        noise : str, optional
            ``kept``, the default, uses the noise calibration stored for this client, ``none`` none.
        hemisphere : str, optional
            ``upper`` or ``lower``, the side of the horizontal plane on which all sources are: a
            level array then tells elevations.
        key : str, optional
            The service's key.
        reconnect : bool, optional
            Whether another session follows a lost one; by default only where ``overflow`` is
            ``drop_oldest``, since no part of a recording may be missing.
        wait_s : float
            Seconds to keep trying the first connection, for a robot that starts before its service.
        queue_s : float
            Most seconds of audio that wait while the network or the service is slow. Beyond that
            the oldest is dropped (``dropped_s``), or ``send`` waits where ``overflow`` is
            ``block``.
        max_unread : int, optional
            Most events that wait to be read; the oldest results go first (``results_dropped``).
        backoff, timeouts
            Delays between attempts, and timeouts for a silent service.

        Raises
        ------
        InvalidMessage, InvalidOption
            If a field or the address is wrong.
        """
        fields = {
            "audio": audio,
            "array": array,
            "channel_map": channel_map,
            "model": model,
            "method": method,
            "output": output,
            "overflow": overflow,
            "client": client,
            "noise": noise,
            "hemisphere": hemisphere,
        }
        options = StreamOptions(
            key, reconnect, wait_s, queue_s, max_unread, backoff or Backoff(), timeouts
        )
        self._sessions = Sessions(stream_url(url), read_start(start, fields), options)

    @property
    def ready(self) -> Ready:
        """The ``ready`` of the session; a reconnection brings a new one."""
        return self._sessions.ready

    @property
    def latest(self) -> Result | None:
        """The newest result, read or not."""
        return self._sessions.latest

    @property
    def summary(self) -> Summary | None:
        """The session as a whole, once it has ended without an error."""
        return self._sessions.summary

    @property
    def live(self) -> bool:
        """True where stale audio is dropped (``overflow: "drop_oldest"``)."""
        return self._sessions.live

    @property
    def connected(self) -> bool:
        """True while a session runs."""
        return self._sessions.outgoing.connected

    @property
    def ended(self) -> bool:
        """True once the stream has ended and all events were read."""
        return self._sessions.inbox.ended

    @property
    def dropped_s(self) -> float:
        """Seconds of audio dropped before they were sent."""
        return self._sessions.outgoing.dropped_s

    @property
    def results_dropped(self) -> int:
        """Number of results dropped because nobody read them."""
        return self._sessions.inbox.results_dropped

    def update(
        self,
        *,
        interval_ms: int | None = None,
        max_sources: int | None = None,
        num_sources: int | Unchanged | None = UNCHANGED,
        include: Sequence[Include] | None = None,
        format: OutputFormat | None = None,
        yaw_deg: float | None = None,
        frame: Frame | None = None,
        exclude_deg: Sequence[Sequence[float]] | None = None,
    ) -> None:
        """Change output options from the next result on, and for later sessions.

        Options that are left out stay the same.

        Parameters
        ----------
        interval_ms : int
            Milliseconds of audio between results.
        max_sources : int
            Most sources in one result.
        num_sources : int or None
            The known number of sources; None lets the service count.
        include : sequence of str
            ``spectrum`` adds 360 values of the spatial spectrum to every result, ``sphere`` an
            image of the sphere where the array tells elevations.
        format : str
            ``doa``, or ``odas`` for ODAS' objects instead of results.
        yaw_deg : float
            Degrees by which the array is turned on the robot, counter-clockwise.
        frame : str
            ``robot`` for directions as the robot is turned at the moment, ``world`` for those in
            the frame of the poses.
        exclude_deg : sequence of pairs
            Sectors (from, to) in degrees in which nothing is reported.

        Raises
        ------
        InvalidMessage
            If a field is unknown or out of range.
        """
        self._sessions.check_running()
        given: dict[str, Any] = {
            "interval_ms": interval_ms,
            "max_sources": max_sources,
            "include": include,
            "format": format,
            "yaw_deg": yaw_deg,
            "frame": frame,
            "exclude_deg": exclude_deg,
        }
        changes = {name: value for name, value in given.items() if value is not None}
        if num_sources is not UNCHANGED:
            changes["num_sources"] = num_sources
        current = self._sessions.start.model_dump(mode="json", exclude_unset=True)
        current["output"] = {**current.get("output", {}), **changes}
        del current["type"]
        start = read_start(None, current)
        fields = {name: getattr(start.output, name) for name in changes}
        self._sessions.start = start  # before sending: a session may be lost at any time
        self._sessions.control(Update(type="update", output=OutputUpdate.model_construct(**fields)))

    def flush(self) -> None:
        """Localize the audio sent so far now; ``Flushed`` follows the last of these results."""
        self._sessions.control(Flush(type="flush"))

    def send_pose(
        self,
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        *,
        quaternion_xyzw: tuple[float, float, float, float] | None = None,
        t: float | None = None,
        capture_time_ns: int | None = None,
    ) -> None:
        """Tell how the robot is turned, as often as it is known; needed only where it turns.

        Parameters
        ----------
        yaw_deg, pitch_deg, roll_deg : float
            Degrees from the world's frame, about z (counter-clockwise), y (nose down) and x.
        quaternion_xyzw : sequence of float, optional
            The rotation as a quaternion, instead of the angles.
        t : float, optional
            Seconds of the stream, as ``t_end``; by default the end of the audio sent so far.
        capture_time_ns : int, optional
            The same by the clock of the audio's ``seq_time`` headers.

        Raises
        ------
        InvalidMessage
            If a number is not finite, or too much or too little is given.
        """
        here = None if t is None else t - self._sessions.began_s
        fields: dict[str, Any] = {"type": "pose", "t": here, "capture_time_ns": capture_time_ns}
        if quaternion_xyzw is None:
            fields |= {"yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
        else:
            fields["quaternion_xyzw"] = tuple(quaternion_xyzw)
        self._sessions.control(read_client_message(json.dumps(fields)))

    def ping(self, id: int | None = None) -> None:
        """Ask for a ``Pong`` with this number."""
        self._sessions.control(Ping(type="ping", id=id))

    def calibrate(self, seconds: float = 5.0) -> None:
        """Learn the robot's noise from the audio that follows; ``Calibrated`` comes at the end."""
        self._sessions.control(Calibrate(type="calibrate", kind="noise", seconds=float(seconds)))

    def take(self) -> StreamEvent | None:
        """``receive`` without waiting, from any thread."""
        return self._sessions.inbox.take()

    def received(self) -> list[StreamEvent]:
        """All unread events, without waiting."""
        self._sessions.check_open()
        events: list[StreamEvent] = []
        while (event := self.take()) is not None:
            events.append(event)
        return events
