"""What the tests of the client and of its command share."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import soundfile
from running_service import RunningService
from scripted_service import Script, ScriptedService
from stream_command import ARRAY, RATE

from service.doa.array import MicrophoneArray


@pytest.fixture
def service_of() -> Iterator[Callable[..., ScriptedService]]:
    """Start scripted services, which are closed after the test."""
    started: list[ScriptedService] = []

    def start(*scripts: Script, **options: Any) -> ScriptedService:
        started.append(ScriptedService(*scripts, **options))
        return started[-1]

    yield start
    for service in started:
        service.close()


@pytest.fixture
def unused_tcp_port() -> int:
    """A port where nobody listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@pytest.fixture(scope="session")
def real_service() -> Iterator[str]:
    """The address of the service itself, on a free port."""
    running = RunningService()
    yield running.url
    running.stop()


@pytest.fixture
def talk_wav(tmp_path: Path, square: MicrophoneArray, plane_waves: Any) -> str:
    path = tmp_path / "talker.wav"
    soundfile.write(path, plane_waves(square, [60], seconds=2.0).T, RATE)
    return str(path)


@pytest.fixture
def stream_flags(real_service: str, talk_wav: str) -> list[str]:
    return [talk_wav, "--array", ARRAY, "--url", real_service, "--method", "norm_music"]
