"""Any sequence of messages, audio, jobs, time and faults leaves a session in a defined state."""

from __future__ import annotations

import json
import struct
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from stream_contract import validator

from neuralmusic.errors import DoaError, WorkerLost
from neuralmusic.protocol.close_codes import CloseCode
from neuralmusic.protocol.server_messages import ServerMessage
from service.api.outbox import message_json
from service.inference.registry import BundleRegistry
from service.streaming.host import StreamHost
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.session import Session
from service.streaming.work import Failed

from .conftest import Driver, pcm, start

LIMITS = SessionLimits(buffer_s=0.5, idle_timeout_s=30.0, max_session_s=300.0)
SAMPLES = 0.01 * np.random.default_rng(0).standard_normal((4, 16_000))
NOISE = pcm(SAMPLES)
FLOATS = SAMPLES.T.astype("<f4").tobytes()
COMMANDS: tuple[dict[str, Any], ...] = (
    {"type": "flush"},
    {"type": "ping", "id": 7},
    {"type": "update", "output": {"interval_ms": 20}},
    {"type": "update", "output": {"format": "odas", "yaw_deg": -90.0}},
    {"type": "update", "output": {"include": ["spectrum"], "exclude_deg": [[10, 200]]}},
    {"type": "update", "output": {"frame": "world"}},
    {"type": "pose", "yaw_deg": 1e300, "t": -5.0},
    {"type": "pose", "t": 1e300, "pitch_deg": 90, "roll_deg": -180.0},
    {"type": "pose", "quaternion_xyzw": [0.5, -0.5, 0.5, 0.5]},
    {"type": "calibrate", "kind": "noise", "seconds": 1},
)
STARTS: tuple[dict[str, Any], ...] = (
    start(method="norm_music"),
    start(method="music", output={"interval_ms": 330, "num_sources": 2}),
    start(method="srp_phat", overflow="block"),
    start(method="norm_music", audio={"header": "seq_time"}, client="robot"),
    start(method="music", audio={"encoding": "pcm_f32le"}, overflow="block"),
    start(method="music", audio={"encoding": "pcm_s32le", "sample_rate": 44_100}),
    start(method="music", audio={"encoding": "pcm_s24le", "sample_rate": 8000}),
)
IMPOSSIBLE: tuple[dict[str, Any], ...] = (
    start(array={"name": "nobody"}),
    start(audio={"channels": 3}),
    start(output={"num_sources": 4}),
    start(channel_map=[0, 0, 1, 2]),
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=6,
)


@cache
def registry() -> BundleRegistry:
    return BundleRegistry.load()


def codes(error: type[DoaError] = DoaError) -> set[str]:
    """Errors that a client may be told; a defect of the service is not among them."""
    return {error.code}.union(*map(codes, error.__subclasses__())) - {"internal"}


class SessionMachine(RuleBasedStateMachine):
    """A client, a worker and a clock, each acting at random."""

    @initialize(
        message=st.sampled_from([*STARTS, None]), eager=st.booleans(), calm=st.integers(0, 20)
    )
    def open(self, message: dict[str, Any] | None, eager: bool, calm: int) -> None:
        self.seen = 0
        self.calm = calm
        """Least steps before a session may end"""
        session = Session("test", Reporter(self.keep), LIMITS, now=0.0)
        self.messages: list[dict[str, Any]] = []
        self.driver = Driver(session, StreamHost(registry()), messages=self.messages, eager=eager)
        self.sequence = 0
        self.longest = 0.0
        """Seconds of the longest binary message"""
        if message is not None:
            self.driver.send(message)

    def keep(self, message: ServerMessage) -> None:
        """A message as it goes over the wire."""
        self.messages.append(json.loads(message_json(message)))

    @property
    def session(self) -> Session:
        return self.driver.session

    @property
    def is_calm(self) -> bool:
        return self.calm > 0

    @precondition(lambda self: not self.is_calm)
    @rule(message=st.sampled_from([*STARTS, *IMPOSSIBLE]))
    def start_again(self, message: dict[str, Any]) -> None:
        self.driver.send(message)

    @rule(message=st.sampled_from(COMMANDS), times=st.sampled_from([1, 1, 1, 1100]))
    def command(self, message: dict[str, Any], times: int) -> None:
        for _ in range(1 if self.is_calm else times):
            self.driver.send(message)

    @precondition(lambda self: not self.is_calm)
    @rule()
    def stop(self) -> None:
        self.driver.send({"type": "stop"})

    @precondition(lambda self: not self.is_calm)
    @rule(
        message=st.sampled_from([*STARTS, *COMMANDS]), name=st.text(max_size=8), value=json_values
    )
    def spoiled(self, message: dict[str, Any], name: str, value: Any) -> None:
        known = name if not name or name[0] > "m" else sorted(message)[ord(name[0]) % len(message)]
        self.driver.send({**message, known: value})

    @precondition(lambda self: not self.is_calm)
    @rule(text=st.text(max_size=30) | st.sampled_from(["{", "null", "[" * 9000, " " * 65_537]))
    def nonsense(self, text: str) -> None:
        self.driver.send(text)

    @precondition(lambda self: self.session.wants_audio)
    @rule(
        seconds=st.sampled_from([0.0, 0.001, 0.0333, 0.1, 0.1]),
        lost=st.sampled_from([0, 0, 0, 1, 7, 2**31]),
    )
    def audio(self, seconds: float, lost: int) -> None:
        begin = self.session.start
        audio = begin.audio if begin is not None else None
        size = audio.frame_bytes if audio is not None else 8
        frames = round(seconds * (audio.sample_rate if audio is not None else 16_000))
        source = FLOATS if audio is not None and audio.encoding == "pcm_f32le" else NOISE * 2
        data = source[: frames * size]
        if audio is not None:
            self.longest = max(self.longest, seconds)
            if audio.header == "seq_time":
                self.sequence += 1 + lost
                captured = self.sequence * 100_000_000
                data = struct.pack("<IIq", 0, self.sequence % 2**32, captured) + data
        self.driver.audio(data, len(data) or 1)

    @precondition(lambda self: not self.is_calm)
    @rule(data=st.binary(max_size=40) | st.sampled_from([b"RIFF" + bytes(60), bytes(65_537)]))
    def bad_audio(self, data: bytes) -> None:
        self.driver.audio(data, 100_000)

    @rule(seconds=st.sampled_from([0.0, 0.1, 1.0, 10.0, 29.0, 31.0]))
    def time_passes(self, seconds: float) -> None:
        self.driver.now += min(seconds, 1.0) if self.is_calm else seconds
        self.session.tick(self.driver.now)

    @rule()
    def work(self) -> None:
        self.driver.work()

    @rule()
    def work_one_step(self) -> None:
        work = self.session.take_work()
        if work is not None:
            self.session.work_done(self.driver.perform(work), self.driver.now)

    @precondition(lambda self: not self.is_calm)
    @rule()
    def lose_the_worker(self) -> None:
        if self.session.take_work() is not None:
            self.session.work_done(Failed(WorkerLost("it ended")), self.driver.now)

    @precondition(lambda self: not self.is_calm)
    @rule()
    def drain(self) -> None:
        self.session.drain()

    @precondition(lambda self: not self.is_calm)
    @rule()
    def vanish(self) -> None:
        self.session.abandon()

    @invariant()
    def the_calm_passes(self) -> None:
        self.calm -= 1

    @invariant()
    def every_message_is_as_documented(self) -> None:
        for number, message in enumerate(self.messages[self.seen :], self.seen):
            validator(message["type"]).validate(message)
            assert message["seq"] == number
            if message["type"] in ("error", "closing"):
                known = codes() if message["type"] == "error" else {"done", "draining", "vanished"}
                assert message["code"] in known
        self.seen = len(self.messages)

    @invariant()
    def the_end_is_said_once_and_nothing_after_it(self) -> None:
        kinds = [message["type"] for message in self.messages]
        ends = [message for message in self.messages if "close_code" in message]
        assert (self.session.state == "closed") == (self.session.close_code is not None)
        assert len(ends) == (self.session.close_code is not None)
        assert kinds.count("ready") <= 1
        if "summary" in kinds:
            assert kinds[-2:] == ["summary", "closing"]
        if ends:
            assert self.messages[-1] is ends[0]
            assert ends[0]["close_code"] == self.session.close_code
            assert self.session.close_code in set(CloseCode)
            assert self.session.take_work() is None
            assert self.session.wants_audio

    @invariant()
    def what_waits_is_bounded(self) -> None:
        interval_s = self.session.output.interval_ms / 1000
        # An update may shorten the interval while audio of the longer one still waits.
        assert self.session.buffered_s <= LIMITS.buffer_s + max(interval_s, 1.0) + self.longest

    def teardown(self) -> None:
        self.driver.work()
        self.every_message_is_as_documented()
        self.the_end_is_said_once_and_nothing_after_it()


QUICK = settings(
    max_examples=60,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)


def test_any_sequence_leaves_a_defined_state() -> None:
    run_state_machine_as_test(SessionMachine, settings=QUICK)  # type: ignore[no-untyped-call]


@pytest.mark.fuzz
def test_many_sequences_leave_a_defined_state() -> None:
    many = settings(QUICK, max_examples=2000, stateful_step_count=50, derandomize=False)
    run_state_machine_as_test(SessionMachine, settings=many)  # type: ignore[no-untyped-call]
