"""A session as a state machine without I/O: messages in, messages out, work for a thread between.

States
------
waiting : for ``start``; audio is an error.
opening : ``start`` was valid; the first work builds the pipeline, audio waits meanwhile.
running : every work takes the audio up to the next result.
closed : ``close_code`` is set; nothing is taken any more.

The owner calls ``receive_text`` and ``receive_bytes``, runs what ``take_work`` gives in a thread,
calls ``work_done`` after it, and sends what the reporter is given. Results depend on the audio and
the order of the messages alone: neither on how the audio is split nor on the time.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from service.doa.diagnostics import Finding
from service.errors import (
    AudioBeforeStart,
    DoaError,
    InvalidMessage,
    MessageTooBig,
    NoiseStoreFull,
    SessionLimit,
    StreamTimeout,
)
from service.protocol import MAX_MESSAGE_BYTES
from service.protocol.client_messages import (
    Calibrate,
    Flush,
    OutputOptions,
    Ping,
    Start,
    Stop,
    Update,
    read_client_message,
)
from service.protocol.close_codes import CloseCode
from service.protocol.server_messages import Calibrated, Flushed, Pong
from service.streaming.intake import Intake
from service.streaming.opening import OpenedStream
from service.streaming.pipeline import Step
from service.streaming.reporter import Reporter, SessionLimits

log = logging.getLogger(__name__)

MAX_COMMANDS = 1000
"""Control messages that wait for the audio before them"""
UNEXPECTED = "the service failed on this stream; its log says why: please report it"

State = Literal["waiting", "opening", "running", "closed"]
Command = Update | Flush | Calibrate | Stop


@dataclass(slots=True)
class _Outcome:
    """What one work gave; filled in by the thread."""

    command: Flush | Stop | None = None
    opened: OpenedStream | None = None
    step: Step | None = None
    keeping_error: DoaError | None = None
    """Why a calibration could not be kept beyond the session"""
    error: Exception | None = None


class Session:
    """One stream.

    Parameters
    ----------
    session_id : str
    open_stream : callable
        Builds the pipeline of a ``start``; runs in a thread, as all work does.
    reporter : Reporter
        Takes every message to the client, in order.
    now : float
        Seconds of a monotonic clock, as in all calls.
    """

    def __init__(
        self,
        session_id: str,
        open_stream: Callable[[Start], OpenedStream],
        reporter: Reporter,
        limits: SessionLimits,
        now: float,
    ) -> None:
        self.id = session_id
        self.state: State = "waiting"
        self.close_code: CloseCode | None = None
        self.start: Start | None = None
        self.opened: OpenedStream | None = None
        self.output = OutputOptions()
        self._open_stream = open_stream
        self._report = reporter
        self._limits = limits
        self._intake: Intake | None = None
        self._commands: deque[tuple[int, Command]] = deque()
        """With the sample frames received before each"""
        self._outcome: _Outcome | None = None
        """Of the work under way"""
        self._findings: list[Finding] | None = None
        """Of the check under way"""
        self._draining = False
        self._began = self._heard = now

    def receive_text(self, text: str, now: float) -> None:
        """Take a control message."""
        if self.state == "closed":
            return
        self._heard = now
        try:
            if len(text) > MAX_MESSAGE_BYTES:
                raise MessageTooBig(f"a control message has {len(text)} characters: at most 64 KiB")
            self._control(read_client_message(text), now)
        except DoaError as error:
            self.fail(error)

    def receive_bytes(self, message: bytes, now: float) -> None:
        """Take a binary message of audio."""
        if self.state == "closed":
            return
        self._heard = now
        try:
            self._audio(message, now)
        except DoaError as error:
            self.fail(error)

    def tick(self, now: float) -> None:
        """Look at the clock, about every second."""
        limits = self._limits
        if now - self._began > limits.max_session_s:
            self.fail(
                SessionLimit(f"a session lasts at most {limits.max_session_s:g} s: reconnect")
            )
        elif now - self._heard > limits.idle_timeout_s:
            self.fail(
                StreamTimeout(
                    f"nothing came for {limits.idle_timeout_s:g} s: send audio, silence included, "
                    "or ping"
                )
            )

    def drain(self) -> None:
        """End the session in order, since the service shuts down: what waits is localized first."""
        if self.state == "running":
            assert self._intake is not None
            self._commands.append((self._intake.received, Stop(type="stop")))
            self._draining = True
        else:
            self._draining = True
            self._end()

    def fail(self, error: DoaError) -> None:
        """End the session with an error."""
        if self.state != "closed":
            self._report.error(error)
            self._close(CloseCode(error.close_code))

    def abandon(self) -> None:
        """The client is gone: nothing can be said any more."""
        if self.state != "closed":
            self._report.closing("vanished", "the client is gone", CloseCode.DONE)  # for watchers
            self._close(CloseCode.DONE)

    @property
    def wants_audio(self) -> bool:
        """False where ``overflow`` is ``block`` and the buffer is full: read nothing then."""
        if self.start is None or self._intake is None or self.start.overflow != "block":
            return True
        return self.state == "closed" or self._intake.buffer.frames < self._capacity(self.start)

    @property
    def buffered_s(self) -> float:
        """Seconds of audio that wait."""
        if self._intake is None or self.start is None:
            return 0.0
        return self._intake.buffer.frames / self.start.audio.sample_rate

    def take_work(self) -> Callable[[], None] | None:
        """What to run in a thread now, or None; one at a time, ``work_done`` after it."""
        if self._outcome is not None or self.state in ("waiting", "closed"):
            return None
        if self.state == "opening":
            assert self.start is not None
            return self._opening(self.start)
        assert self.opened is not None
        assert self._intake is not None
        while self._commands:
            needed = self.opened.pipeline.frames_needed(self.output.interval_ms)
            before = self._commands[0][0] - self._intake.removed
            if before > 0:
                return self._step(min(before, needed))
            command = self._commands.popleft()[1]
            if isinstance(command, Flush | Stop):
                return self._step(0, command)
            self._apply(command)
        needed = self.opened.pipeline.frames_needed(self.output.interval_ms)
        return self._step(needed) if self._intake.buffer.frames >= needed else None

    def work_done(self, now: float) -> None:
        """Take in what the work gave."""
        outcome, self._outcome = self._outcome, None
        assert outcome is not None
        if self.state == "closed":
            return
        if isinstance(outcome.error, DoaError):
            self.fail(outcome.error)
        elif outcome.error is not None:
            log.error("session %s failed", self.id, exc_info=outcome.error)
            self.fail(DoaError(UNEXPECTED))
        elif outcome.opened is not None:
            self.opened, self.state = outcome.opened, "running"
            self._report.ready(self.id, outcome.opened, self.output, self._limits)
        else:
            self._stepped(outcome, now)

    def take_check(self) -> Callable[[], None] | None:
        """A look at the channels to run in a thread of little priority, or None.

        It may run beside a work, one at a time; ``check_done`` after it.
        """
        if self._findings is not None or self.opened is None or self.state != "running":
            return None
        diagnostics = self.opened.pipeline.diagnostics
        if not diagnostics.due():
            return None
        findings = self._findings = []

        def check() -> None:
            try:
                findings.extend(diagnostics.check())
            except Exception:  # a broken check must not end a stream
                log.exception("the diagnostics of session %s failed", self.id)

        return check

    def check_done(self) -> None:
        """Warn of what the check found."""
        findings, self._findings = self._findings, None
        if self.state == "closed":
            return
        for finding in findings or ():
            self._report.warn(finding.code, finding.detail, channels=finding.channels)

    def _control(
        self, message: Start | Update | Flush | Ping | Calibrate | Stop, now: float
    ) -> None:
        if isinstance(message, Ping):
            self._report.emit(Pong, id=message.id)
        elif isinstance(message, Start):
            if self.state != "waiting":
                raise InvalidMessage("the session has been started: open another for other audio")
            self.start, self.output = message, message.output
            self._intake = Intake(message.audio)
            self.state = "opening"
        elif isinstance(message, Stop) and self.state == "waiting":
            self._end()
        elif self._intake is None:
            raise InvalidMessage(f"{message.type} came before start: send start first")
        elif len(self._commands) >= MAX_COMMANDS:
            raise InvalidMessage(
                f"{MAX_COMMANDS} control messages wait for the audio before them: send fewer"
            )
        else:
            self._commands.append((self._intake.received, message))

    def _audio(self, message: bytes, now: float) -> None:
        if self._intake is None or self.start is None:
            raise AudioBeforeStart(
                "binary audio came before start: send the JSON message start first, as text"
            )
        if self._commands and isinstance(self._commands[-1][1], Stop):
            return  # what follows a stop is not of this session
        rate, before = self.start.audio.sample_rate, self._intake.received
        gap = self._intake.receive(message, now)
        if gap is not None:
            self._report.gap(gap, rate)
        self._report.received((self._intake.received - before) / rate, self.buffered_s)
        if self.start.overflow == "drop_oldest":
            buffer = self._intake.buffer
            dropped = 0
            if buffer.frames > self._capacity(self.start):
                dropped = buffer.keep(round(rate * self.output.interval_ms / 1000))
            self._report.dropped(dropped / rate, now)

    def _capacity(self, start: Start) -> int:
        """Sample frames that may wait."""
        seconds = self._limits.buffer_s + self.output.interval_ms / 1000
        return round(seconds * start.audio.sample_rate)

    def _opening(self, start: Start) -> Callable[[], None]:
        outcome = self._outcome = _Outcome()

        def work() -> None:
            try:
                outcome.opened = self._open_stream(start)
            except Exception as error:
                outcome.error = error

        return work

    def _step(self, frames: int, command: Flush | Stop | None = None) -> Callable[[], None]:
        assert self.opened is not None
        assert self._intake is not None
        outcome = self._outcome = _Outcome(command)
        opened, output = self.opened, self.output
        pieces = self._intake.buffer.take(frames)

        def work() -> None:
            try:
                step = opened.pipeline.step(pieces, output, final=command is not None)
                outcome.step = step
                if step.calibrated is not None and opened.keep_noise is not None:
                    opened.keep_noise(step.calibrated)
            except NoiseStoreFull as error:
                outcome.keeping_error = error
            except Exception as error:
                outcome.error = error

        return work

    def _stepped(self, outcome: _Outcome, now: float) -> None:
        step, final = outcome.step, outcome.command is not None
        assert step is not None
        if step.estimate is not None:
            self._report.result(step.estimate, self.output, now, final=final)
        if step.calibrated is not None:
            assert self.start is not None
            kept = None if outcome.keeping_error else self.start.client
            self._report.emit(Calibrated, name=kept, seconds=round(step.calibrated.seconds, 3))
        for error in (step.calibration_error, outcome.keeping_error):
            if error is not None:
                self._report.warn("calibration_failed", error.detail)
        if isinstance(outcome.command, Flush):
            self._report.emit(Flushed, t_end=round(self._report.account.t_end, 6))
        elif isinstance(outcome.command, Stop):
            self._end()

    def _apply(self, command: Update | Calibrate) -> None:
        if isinstance(command, Update):
            changed = command.output.model_dump(exclude_unset=True)
            self.output = self.output.model_copy(update=changed)
        else:
            assert self.opened is not None
            self.opened.pipeline.calibrate(command.seconds)

    def _end(self) -> None:
        """Close in order, with the summary."""
        if self.state == "closed":
            return
        if self.opened is not None:
            self._report.summary()
        if self._draining:
            code, detail = CloseCode.DRAINING, "the service is shutting down: connect again"
        else:
            code, detail = CloseCode.DONE, "the session was stopped"
        self._report.closing("draining" if self._draining else "done", detail, code)
        self._close(code)

    def _close(self, close_code: CloseCode) -> None:
        self.state, self.close_code = "closed", close_code
        self._commands.clear()
        self.opened = None
        self._intake = None
