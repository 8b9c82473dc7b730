"""A session as a state machine without I/O: messages in, messages out, work in between.

States
------
waiting : for ``start``; audio is an error.
opening : ``start`` was valid; the first job builds the pipeline, audio waits meanwhile.
running : every job takes the audio up to the next result.
closed : ``close_code`` is set; messages are ignored.

The owner calls ``receive_text`` and ``receive_bytes``, runs the jobs that ``take_work`` gives,
calls ``work_done`` with their outcomes, and sends the reporter's messages. Results depend only on
the audio and the order of the messages, neither on how the audio is split nor on the time.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

from neuralmusic.errors import (
    AudioBeforeStart,
    DoaError,
    InvalidMessage,
    MessageTooBig,
    SessionLimit,
    StreamTimeout,
    TooManySources,
)
from neuralmusic.protocol import MAX_TEXT
from neuralmusic.protocol.client_messages import (
    AnyClientMessage,
    Calibrate,
    Flush,
    OutputOptions,
    Ping,
    Start,
    Stop,
    Update,
    read_client_message,
)
from neuralmusic.protocol.client_messages import Pose as PoseMessage
from neuralmusic.protocol.close_codes import CloseCode
from neuralmusic.protocol.server_messages import Calibrated, Flushed, Pong
from service.doa.whitening import NoiseCovariance
from service.inference.choice import check_num_sources
from service.streaming.clock import StreamClock
from service.streaming.intake import Intake
from service.streaming.poses import POSE_STALE, WaitingPoses
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.work import (
    Advance,
    Advanced,
    Check,
    Checked,
    Failed,
    Keep,
    Kept,
    Open,
    Outcome,
    StreamOpened,
)

MAX_COMMANDS = 1000
"""Most control messages that wait for the audio before them"""

JOB_BYTES = 512 * 1024
"""Most bytes of audio in one job: a worker's other streams, and the service itself, wait for it"""

State = Literal["waiting", "opening", "running", "closed"]
Command = Update | Flush | Calibrate | Stop
Purpose = Flush | Stop | Literal["opening", "audio"] | None


class Session:
    """One stream.

    Parameters
    ----------
    session_id : str
    reporter : Reporter
        Takes every message to the client, in order.
    now : float
        Seconds of a monotonic clock, as in all calls.
    """

    def __init__(
        self,
        session_id: str,
        reporter: Reporter,
        limits: SessionLimits,
        now: float,
    ) -> None:
        self.id = session_id
        self.state: State = "waiting"
        self.close_code: CloseCode | None = None
        self.start: Start | None = None
        self.output = OutputOptions()
        self._report = reporter
        self._limits = limits
        self._intake: Intake | None = None
        self._commands: deque[tuple[int, Command]] = deque()
        """Waiting commands, each with the sample frames received before it"""
        self._poses: WaitingPoses | None = None
        self._clock: StreamClock | None = None
        self._microphones = 0
        """Number of microphones, once the array is known"""
        self._unkept: tuple[Keep, Purpose] | None = None
        """The job that stores learnt noise, and the purpose of the job that learnt it"""
        self._calibrate_s: float | None = None
        """Seconds of a calibration that begins with the next audio"""
        self._working: Purpose = None
        """Purpose of the job in progress"""
        self._check: Literal["due", "running"] | None = None
        self._stopping = False
        """Whether ``stop`` was received: later messages do not belong to this session"""
        self._draining = False
        self._began = self._heard = now

    def receive_text(self, text: str, now: float) -> None:
        """Take a control message."""
        if self.state == "closed":
            return
        self._heard = now
        try:
            if len(text) > MAX_TEXT:
                raise MessageTooBig(f"a control message has {len(text)} characters: at most 64 KiB")
            self._control(read_client_message(text))
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
        """Check the deadlines; call it about every second."""
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
        """End the session gracefully at shutdown: waiting audio is localized first."""
        self._draining = True
        if self.state == "running":
            assert self._intake is not None
            self._append(self._intake, Stop(type="stop"))
        else:
            self._end()

    def fail(self, error: DoaError) -> None:
        """End the session with an error."""
        if self.state != "closed":
            self._close(CloseCode(error.close_code))
            self._report.error(error)

    def abandon(self) -> None:
        """End the session of a client that is gone."""
        if self.state != "closed":
            self._close(CloseCode.DONE)
            self._report.closing("vanished", "the client is gone", CloseCode.DONE)  # for watchers

    @property
    def wants_audio(self) -> bool:
        """False where ``overflow`` is ``block`` and the buffer is full: stop reading then."""
        if self.start is None or self._intake is None or self.start.overflow != "block":
            return True
        return self.state == "closed" or self._intake.buffer.frames < self._capacity(self.start)

    @property
    def buffered_s(self) -> float:
        """Seconds of waiting audio."""
        if self._intake is None or self.start is None:
            return 0.0
        return self._intake.buffer.frames / self.start.audio.sample_rate

    def take_work(self) -> Open | Advance | Keep | None:
        """The next job, or None; call ``work_done`` before the one after it."""
        if self._working is not None or self.state in ("waiting", "closed"):
            return None
        assert self.start is not None
        assert self._intake is not None
        if self.state == "opening":
            self._working = "opening"
            return Open(self.id, self.start)
        if self._unkept is not None:
            keep, self._working = self._unkept
            return keep
        assert self._clock is not None
        while self._commands:
            needed = self._frames_of_job(self._clock)
            before = self._commands[0][0] - self._intake.removed
            if before > 0:
                return self._advance(min(before, needed), "audio")
            command = self._commands.popleft()[1]
            if isinstance(command, Flush | Stop):
                return self._advance(0, command)
            try:
                self._apply(command)
            except TooManySources as error:
                self.fail(error)
                return None
        needed = self._frames_of_job(self._clock)
        return self._advance(needed, "audio") if self._intake.buffer.frames >= needed else None

    def work_done(self, outcome: Outcome, now: float) -> None:
        """Take in the outcome of a job."""
        purpose, self._working = self._working, None
        if self.state == "closed":
            return
        if isinstance(outcome, Failed):
            self.fail(outcome.error)
        elif isinstance(outcome, StreamOpened):
            assert self.start is not None
            self.state, self._clock = "running", outcome.clock
            self._microphones = len(outcome.array.positions_m)
            self._report.ready(self.id, outcome, self.start, self._limits)
        elif isinstance(outcome, Advanced):
            self._advanced(outcome, purpose, now)
        elif isinstance(outcome, Kept):
            self._kept(outcome, purpose)

    def take_check(self) -> Check | None:
        """A check of the channels, which may run beside another job, or None."""
        if self._check != "due" or self.state != "running":
            return None
        self._check = "running"
        return Check(self.id)

    def check_done(self, outcome: Outcome) -> None:
        """Warn of what a check found."""
        self._check = None
        if self.state == "closed" or not isinstance(outcome, Checked):
            return
        for finding in outcome.findings:
            self._report.warn(finding.code, finding.detail, channels=finding.channels)

    def _control(self, message: AnyClientMessage) -> None:
        if isinstance(message, Ping):
            self._report.emit(Pong, id=message.id)
        elif isinstance(message, Start):
            if self.state != "waiting":
                raise InvalidMessage("the session has been started: open another for other audio")
            self.start, self.output = message, message.output
            self._intake = Intake(message.audio)
            self._poses = WaitingPoses(message.audio, self._intake)
            self.state = "opening"
            self._report.opening()
        elif isinstance(message, Stop) and self.state == "waiting":
            self._end()
        elif self._intake is None:
            raise InvalidMessage(f"{message.type} came before start: send start first")
        elif isinstance(message, PoseMessage):
            assert self._poses is not None
            self._poses.add(message)
        elif len(self._commands) >= MAX_COMMANDS:
            raise InvalidMessage(
                f"{MAX_COMMANDS} control messages wait for the audio before them: send fewer"
            )
        else:
            self._append(self._intake, message)

    def _append(self, intake: Intake, command: Command) -> None:
        """Queue a command behind the audio before it."""
        if not self._stopping:
            self._commands.append((intake.received, command))
            self._stopping = isinstance(command, Stop)

    def _audio(self, message: bytes, now: float) -> None:
        if self._intake is None or self.start is None:
            raise AudioBeforeStart(
                "binary audio came before start: send the JSON message start first, as text"
            )
        if self._stopping:
            return
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
        """Most sample frames that wait."""
        seconds = self._limits.buffer_s + self.output.interval_ms / 1000
        return round(seconds * start.audio.sample_rate)

    def _frames_of_job(self, clock: StreamClock) -> int:
        """Sample frames of the next job: up to the next result, in pieces that nobody waits for."""
        assert self.start is not None
        most = max(1, JOB_BYTES // self.start.audio.frame_bytes)
        return min(clock.frames_needed(self.output.interval_ms), most)

    def _advance(self, frames: int, purpose: Flush | Stop | Literal["audio"]) -> Advance:
        assert self._intake is not None
        assert self._poses is not None
        self._working = purpose
        calibrate_s, self._calibrate_s = self._calibrate_s, None
        pieces = self._intake.buffer.take(frames)
        final = purpose != "audio"
        return Advance(self.id, pieces, self.output, final, calibrate_s, self._poses.take())

    def _advanced(
        self,
        outcome: Advanced,
        purpose: Purpose,
        now: float,
    ) -> None:
        self._clock = outcome.clock
        if outcome.check_due and self._check is None:
            self._check = "due"
        if outcome.estimate is not None:
            final = purpose != "audio"
            self._report.result(outcome.estimate, self.output, now, final=final)
            assert self._poses is not None
            if self._poses.stale(outcome.estimate.t_end):
                self._report.warn("pose_stale", POSE_STALE)
        if outcome.calibration_error is not None:
            self._report.warn("calibration_failed", outcome.calibration_error)
        if outcome.calibrated is not None:
            assert self.start is not None
            if self.start.client is not None:
                self._unkept = Keep(self.start.client, outcome.calibrated), purpose
                return  # told once it is stored
            self._calibrated(None, outcome.calibrated)
        self._conclude(purpose)

    def _kept(self, outcome: Kept, purpose: Purpose) -> None:
        assert self._unkept is not None
        (kept, _), self._unkept = self._unkept, None
        if outcome.error is not None:
            self._report.warn(
                "calibration_failed",
                f"the noise is used for this stream, but was not stored: {outcome.error}",
            )
        self._calibrated(kept.name if outcome.error is None else None, kept.noise)
        self._conclude(purpose)

    def _calibrated(self, name: str | None, noise: NoiseCovariance) -> None:
        self._report.emit(Calibrated, name=name, seconds=round(noise.seconds, 3))

    def _conclude(self, purpose: Purpose) -> None:
        """Tell that all audio before a command is localized."""
        if isinstance(purpose, Flush):
            self._report.emit(Flushed, t_end=round(self._report.account.t_end, 6))
        elif isinstance(purpose, Stop):
            self._end()

    def _apply(self, command: Update | Calibrate) -> None:
        if isinstance(command, Update):
            check_num_sources(command.output.num_sources, self._microphones)
            changed = command.output.model_dump(exclude_unset=True)
            self.output = self.output.model_copy(update=changed)
        else:
            self._calibrate_s = command.seconds

    def _end(self) -> None:
        """Close gracefully, with the summary."""
        if self.state == "closed":
            return
        if self._clock is not None:
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
        self._intake = self._poses = None
