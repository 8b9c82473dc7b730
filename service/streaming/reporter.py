"""Messages of a session to its client: each is numbered, counted and passed on here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from neuralmusic.errors import DoaError
from neuralmusic.protocol import MAX_MESSAGE_BYTES
from neuralmusic.protocol.client_messages import OutputOptions, Start
from neuralmusic.protocol.close_codes import RETRYABLE, CloseCode
from neuralmusic.protocol.server_messages import (
    Closing,
    Limits,
    NoiseInUse,
    OdasSsl,
    OdasSst,
    Ready,
    Result,
    ServerMessage,
    Stats,
    StreamError,
    StreamWarning,
    Summary,
    Timing,
    WarningCode,
)
from service.doa.orientation import Orientation
from service.streaming.account import Account
from service.streaming.answers import (
    odas_potentials,
    odas_sources,
    odas_time_stamp,
    result_fields,
    stream_source,
)
from service.streaming.intake import Gap
from service.streaming.pipeline import Estimate
from service.streaming.work import StreamOpened

CONVENTION = (
    "azimuth in degrees in [0, 360), counter-clockwise from +x; x forward, y left, z up; "
    "output.yaw_deg is added"
)
STATS_S = 5.0
"""Seconds of audio between two ``stats``"""
WARNING_S = 1.0
"""Least seconds between two warnings of dropped audio"""
MAX_HELD = 100
"""Most messages that wait for ``ready``; ``summary`` counts later warnings, too"""


@dataclass(frozen=True, slots=True)
class SessionLimits:
    """The limits of a session, from the settings."""

    buffer_s: float = 0.5
    """Most seconds of audio, beyond one interval, that wait"""
    idle_timeout_s: float = 30.0
    """Seconds without any message after which the session ends"""
    max_session_s: float = 86_400.0
    """Longest session in seconds"""


class Reporter:
    """Numbers a session's messages and keeps its account."""

    def __init__(self, on_message: Callable[[ServerMessage], None]) -> None:
        self.account = Account()
        self.watched = False
        """Whether the session has watchers: every result then gets its spectrum"""
        self.on_message = on_message
        self._session: str | None = None
        """Id of the session, once ``ready`` was sent"""
        self._opening = False
        """Whether ``start`` was received, and neither ``ready`` nor an error sent"""
        self._held: list[tuple[type[ServerMessage], dict[str, Any]]] = []
        """Messages that wait for ``ready``"""
        self._sequence = 0
        self._warned = -WARNING_S
        self._unreported = 0.0
        """Seconds of audio dropped since the last warning"""
        self._stats_due = STATS_S

    def emit(self, message: type[ServerMessage], **fields: Any) -> None:
        """Send one message, after ``ready`` if it does not end the session."""
        if self._opening and message not in (Ready, StreamError, Summary, Closing):
            if len(self._held) < MAX_HELD:
                self._held.append((message, fields))
            return
        self._opening = False
        # Validation would be wasted: the fields come from this package, and results are many.
        self.on_message(message.model_construct(seq=self._sequence, **fields))
        self._sequence += 1

    def opening(self) -> None:
        """Hold what comes before ``ready``: a ``start`` that fails gets its error first."""
        self._opening = True

    def ready(
        self,
        session: str,
        opened: StreamOpened,
        start: Start,
        limits: SessionLimits,
    ) -> None:
        """Send what is in effect."""
        interval_ms = start.output.interval_ms
        noise = None
        if opened.noise_s is not None and start.client is not None:
            noise = NoiseInUse(name=start.client, seconds=round(opened.noise_s, 3))
        self._session = session
        self.emit(
            Ready,
            session=session,
            model=opened.model,
            method=opened.method,
            array=opened.array,
            channel_map=list(opened.channel_map),
            convention=CONVENTION,
            timing=Timing(
                interval_ms=interval_ms,
                window_ms=round(1000 * opened.window_s, 1),
                algorithmic_latency_ms=round(1000 * opened.frame_s + interval_ms / 2, 1),
                sample_rate=opened.sample_rate,
            ),
            limits=Limits(
                max_message_bytes=MAX_MESSAGE_BYTES,
                buffer_ms=round(1000 * limits.buffer_s) + interval_ms,
                idle_timeout_s=limits.idle_timeout_s,
                max_session_s=limits.max_session_s,
            ),
            noise=noise,
        )
        for warning in opened.warnings:
            self.warn(warning.code, warning.detail)
        held, self._held = self._held, []
        for message, fields in held:
            self.emit(message, **fields)

    def result(self, estimate: Estimate, output: OutputOptions, now: float, *, final: bool) -> None:
        """Send one result in the requested format."""
        arrived = now if estimate.arrived is None else estimate.arrived
        lag_ms = round(1000 * max(0.0, now - arrived), 1)
        excluded = output.exclude_deg
        if output.frame == "world" and estimate.pose is not None:
            turn = math.degrees(estimate.pose.yaw)
            excluded = tuple((first + turn, last + turn) for first, last in excluded)
        orientation = Orientation.of_degrees(output.yaw_deg, excluded)
        sources = [stream_source(track, orientation) for track in estimate.tracks]
        self.account.add(estimate, sources, lag_ms)
        if output.format == "odas":
            stamp = odas_time_stamp(estimate)
            told = {"session": self._session, "timeStamp": stamp}
            self.emit(OdasSsl, **told, src=odas_potentials(estimate, orientation))
            self.emit(OdasSst, **told, src=odas_sources(estimate, orientation))
        else:
            spectrum = self.watched or "spectrum" in output.include
            fields = result_fields(estimate, sources, orientation, spectrum=spectrum)
            self.emit(Result, session=self._session, **fields, lag_ms=lag_ms, final=final)

    def received(self, seconds: float, buffered_s: float) -> None:
        """Count received audio; send ``stats`` when they are due."""
        self.account.audio_s += seconds
        if self.account.audio_s < self._stats_due:
            return
        self._stats_due = self.account.audio_s + STATS_S
        account = self.account
        self.emit(
            Stats,
            audio_s=round(account.audio_s, 3),
            results=account.results,
            dropped_s=round(account.dropped_s, 3),
            gap_s=round(account.gap_s, 3),
            results_dropped=account.results_dropped,
            lag_ms=account.mean_lag_ms(),
            buffered_ms=round(1000 * buffered_s, 1),
        )

    def dropped(self, seconds: float, now: float) -> None:
        """Count dropped audio and warn of it, at most once a second."""
        self.account.dropped_s += seconds
        self._unreported += seconds
        if self._unreported == 0 or now - self._warned < WARNING_S:
            return
        duration, self._unreported, self._warned = self._unreported, 0.0, now
        self.warn(
            "audio_dropped",
            f"{1000 * duration:.0f} ms of audio were dropped so that results describe the "
            "present: the service is overloaded, or the audio came in a burst; for files use "
            "overflow block",
            duration_ms=round(1000 * duration, 1),
        )

    def gap(self, gap: Gap, sample_rate: int) -> None:
        """Warn of missing messages."""
        seconds = gap.frames / sample_rate
        self.account.gap_s += seconds
        if gap.messages == 0:
            detail = "the sequence numbers started again: how much audio is missing is unknown"
        elif gap.frames:
            detail = (
                f"{gap.messages} messages with {1000 * seconds:.0f} ms of audio are missing: the "
                "sender or the network lost them"
            )
        else:
            detail = (
                f"{gap.messages} messages are missing, but the capture times show no gap of up to "
                "an hour"
            )
        self.warn("audio_gap", detail, duration_ms=round(1000 * seconds, 1))

    def warn(
        self,
        code: WarningCode | str,
        detail: str,
        *,
        channels: Sequence[int] = (),
        duration_ms: float | None = None,
    ) -> None:
        """Send and count one warning."""
        self.account.warnings[code] += 1
        self.emit(
            StreamWarning,
            code=code,
            detail=detail,
            channels=tuple(channels),
            duration_ms=duration_ms,
        )

    def summary(self) -> None:
        """Send the account."""
        account = self.account
        self.emit(
            Summary,
            audio_s=round(account.audio_s, 3),
            results=account.results,
            dropped_s=round(account.dropped_s, 3),
            gap_s=round(account.gap_s, 3),
            sources=list(account.tracks()),
            warnings=dict(account.warnings),
        )

    def error(self, error: DoaError) -> None:
        """Send the error that ends the session."""
        self.emit(
            StreamError,
            code=error.code,
            title=error.title,
            detail=error.detail,
            retryable=error.retryable or error.close_code in RETRYABLE,
            close_code=error.close_code,
        )

    def closing(self, code: str, detail: str, close_code: CloseCode) -> None:
        """Send the end of a session that ends without an error."""
        self.emit(Closing, code=code, detail=detail, close_code=int(close_code))
