"""``neuralmusic stream --device`` with a stand-in for PortAudio."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scripted_service import TIMEOUT_S, Peer, ScriptedService, error, result
from stream_command import ARRAY, RATE, refusal, run

from neuralmusic.protocol.framing import HEADER
from neuralmusic.sources.microphone import capture_time_ns


class PortAudio(ModuleType):
    """A stand-in for sounddevice: one device that records until the stream has ended."""

    class PortAudioError(Exception): ...

    class CallbackStop(Exception): ...

    def __init__(self) -> None:
        super().__init__("sounddevice")
        self.opened: dict[str, Any] = {}
        self.devices = [
            {"name": "speaker", "max_input_channels": 0, "default_samplerate": 48_000.0},
            {"name": "ReSpeaker 4 Mic", "max_input_channels": 6, "default_samplerate": 16_000.0},
        ]

    def query_devices(self, name: Any = None, kind: str | None = None) -> Any:
        if name is None:
            return self.devices
        found = [d for i, d in enumerate(self.devices) if name == i or str(name) in d["name"]]
        if len(found) != 1:
            raise ValueError(f"No input device matching {name!r}")
        return found[0]

    def RawInputStream(self, **how: Any) -> Any:
        self.opened = how
        return _Recording(self, how)


class _Recording:
    """Calls back from its own thread, as PortAudio does."""

    def __init__(self, portaudio: PortAudio, how: dict[str, Any]) -> None:
        self._stopped = threading.Event()
        self._stop, self._how = portaudio.CallbackStop, how
        self._thread = threading.Thread(target=self._record)

    def _record(self) -> None:
        size, second = self._how["blocksize"], 0.0
        block = np.full((size, self._how["channels"]), 7, np.int16)
        moment = SimpleNamespace(inputBufferAdcTime=5.0, currentTime=5.02)
        try:
            while not self._stopped.wait(1e-4):
                self._how["callback"](memoryview(block).cast("B"), size, moment, None)
                second += size / RATE
        except self._stop:
            self._how["finished_callback"]()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join(TIMEOUT_S)


@pytest.fixture
def portaudio(monkeypatch: pytest.MonkeyPatch) -> PortAudio:
    module = PortAudio()
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    return module


def test_a_device_is_recorded_with_its_own_channels_and_rate(
    portaudio: PortAudio,
    service_of: Callable[..., ScriptedService],
    capsys: pytest.CaptureFixture[str],
) -> None:
    heard: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.begin()
        heard.extend(peer.hear() for _ in range(5))
        peer.say(result(1, 45.0), error("unauthorized", 4401))
        peer.close(4401)

    service = service_of(script)
    code, out, err = run(capsys, "--device", "ReSpeaker", "--array", ARRAY, "--url", service.url)
    assert (code, err) == (2, "error: because of unauthorized\n")
    assert json.loads(out)["sources"][0]["azimuth_deg"] == 45.0
    start = service.peers[0].start
    assert start["audio"] == {
        "encoding": "pcm_s16le",
        "sample_rate": 16_000,
        "channels": 6,
        "header": "seq_time",
    }
    assert start["array"] == {"name": ARRAY}
    assert start["overflow"] == "drop_oldest"
    assert all(set(message[HEADER.size :]) == {7, 0} for message in heard)
    assert (portaudio.opened["dtype"], portaudio.opened["blocksize"]) == ("int16", 320)


def test_the_age_of_audio_is_taken_from_now() -> None:
    at = SimpleNamespace
    now = capture_time_ns(at(inputBufferAdcTime=7.0, currentTime=7.0))
    older = capture_time_ns(at(inputBufferAdcTime=7.0, currentTime=8.0))
    assert now is not None
    assert older is not None
    assert older < now
    assert capture_time_ns(at(inputBufferAdcTime=0.0, currentTime=8.0)) is None


def test_devices_are_listed_and_unknown_ones_refused(
    portaudio: PortAudio, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "--list-devices")
    assert code == 0
    assert [line.split() for line in out.splitlines()[1:]] == [
        ["1", "6", "16000", "ReSpeaker", "4", "Mic"]
    ]
    assert "see --list-devices" in refusal(capsys, "--device", "lamp", "--array", ARRAY)
    portaudio.devices.pop()
    assert "no device records" in run(capsys, "--list-devices")[1]


def test_missing_libraries_are_one_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    device = ["--device", "ReSpeaker", "--array", ARRAY]
    assert "./client[microphone]" in refusal(capsys, *device)
    assert "./client[microphone]" in refusal(capsys, "--list-devices")
    (tmp_path / "sounddevice.py").write_text('raise OSError("PortAudio library not found")')
    monkeypatch.delitem(sys.modules, "sounddevice")
    monkeypatch.syspath_prepend(tmp_path)
    assert "libportaudio2" in refusal(capsys, *device)
