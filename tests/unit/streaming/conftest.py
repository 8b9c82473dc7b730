"""Sessions driven without sockets, threads or clocks."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from neuralmusic.protocol.message import message_type
from neuralmusic.protocol.server_messages import ServerMessage
from service.doa.types import FloatArray
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
from service.streaming.calibrations import keep, with_noise
from service.streaming.host import StreamHost
from service.streaming.reporter import Reporter, SessionLimits
from service.streaming.session import Session
from service.streaming.work import Advance, Keep, Open, Outcome

ARRAY = "respeaker-usb-4mic-v2"


def start(**changes: Any) -> dict[str, Any]:
    """A valid ``start``; keys of parts replace that part's."""
    message: dict[str, Any] = {
        "type": "start",
        "audio": {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4},
        "array": {"name": ARRAY},
    }
    for key, value in changes.items():
        part = message.get(key)
        message[key] = {**part, **value} if isinstance(part, dict) else value
    return message


def pcm(audio: FloatArray) -> bytes:
    """Audio (N, T) as interleaved 16-bit samples."""
    return np.round(audio.T * 32767).astype("<i2").tobytes()


@dataclass
class Driver:
    """One session whose work is done at once, or when ``work`` is called."""

    session: Session
    host: StreamHost
    store: NoiseStore = field(default_factory=NoiseStore)
    messages: list[dict[str, Any]] = field(default_factory=list)
    now: float = 0.0
    eager: bool = True

    def send(self, message: dict[str, Any] | str) -> None:
        text = message if isinstance(message, str) else json.dumps(message)
        self.session.receive_text(text, self.now)
        if self.eager:
            self.work()

    def audio(self, data: bytes, size: int = 8192) -> None:
        """Send bytes in messages of ``size`` bytes."""
        for begin in range(0, len(data), size):
            self.session.receive_bytes(data[begin : begin + size], self.now)
            if self.eager:
                self.work()

    def work(self) -> None:
        while (work := self.session.take_work()) is not None:
            self.session.work_done(self.perform(work), self.now)
        while (check := self.session.take_check()) is not None:
            checked = self.host.perform(check)
            assert checked is not None
            self.session.check_done(checked)

    def perform(self, work: Open | Advance | Keep) -> Outcome:
        """The outcome of a job, wherever the service would do it."""
        if isinstance(work, Keep):
            return keep(work, self.store)
        given = with_noise(work, self.store) if isinstance(work, Open) else work
        outcome = self.host.perform(given)
        assert outcome is not None
        return outcome

    def all(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.messages if message["type"] == kind]

    def only(self, kind: str) -> dict[str, Any]:
        (message,) = self.all(kind)
        return message

    @property
    def last(self) -> dict[str, Any]:
        return self.messages[-1]


NewSession = Callable[..., Driver]


@pytest.fixture(scope="session")
def registry() -> BundleRegistry:
    return BundleRegistry.load()


@pytest.fixture
def store() -> NoiseStore:
    return NoiseStore()


@pytest.fixture
def new_session(registry: BundleRegistry, store: NoiseStore) -> NewSession:
    def make(limits: SessionLimits | None = None, *, eager: bool = True) -> Driver:
        messages: list[dict[str, Any]] = []

        def keep(message: ServerMessage) -> None:
            kind = message_type(type(message))
            messages.append({"type": kind, **message.model_dump(mode="json")})

        session = Session(
            "test",
            Reporter(keep),
            limits or SessionLimits(),
            now=0.0,
        )
        return Driver(session, StreamHost(registry), store, messages, eager=eager)

    return make
