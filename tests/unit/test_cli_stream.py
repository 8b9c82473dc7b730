"""``neuralmusic stream`` as users meet it: outputs, devices, interruption, errors in a sentence."""

from __future__ import annotations

import csv
import io
import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile
from rich.console import Console
from scripted_service import TIMEOUT_S, Peer, ScriptedService, error, ready, result, summary

from service.cli import main
from service.cli.addresses import Address, read_address
from service.cli.live import FileSource, follow, paced
from service.cli.microphone import capture_time_ns
from service.cli.odas import odas_text
from service.cli.stream_table import LiveTable
from service.client import Reconnecting, StreamClient
from service.doa.array import MicrophoneArray
from service.errors import InvalidOption
from service.protocol.framing import HEADER
from service.protocol.server_messages import (
    OdasPotential,
    OdasSource,
    OdasSsl,
    OdasSst,
    StreamWarning,
)

ARRAY = "respeaker-usb-4mic-v2"
RATE = 16_000
SST = OdasSst(
    seq=1,
    timeStamp=57,
    src=[
        OdasSource(id=3, tag="dynamic", x=0.5, y=-0.8660254, z=0.0, activity=0.9),
        OdasSource(id=0, tag="", x=0.0, y=0.0, z=0.0, activity=0.0),
    ],
)
SSL = OdasSsl(seq=2, timeStamp=57, src=[OdasPotential(x=1.0, y=0.0, z=0.0, E=0.25)] * 4)


def test_odas_objects_are_printed_as_odas_prints_them() -> None:
    """By the format strings of snk_tracks.c and snk_pots.c, evaluated by printf itself."""
    rows = [
        'printf \'        { "id": %d, "tag": "%s", "x": %1.3f, "y": %1.3f, "z": %1.3f, '
        f'"activity": %1.3f }}{comma}\\n\' {values}'
        for values, comma in [
            ("3 dynamic 0.5 -0.8660254 0 0.9", ","),
            *[("0 '' 0 0 0 0", comma) for comma in (",", ",", "")],
        ]
    ]
    head, tail = 'printf \'{\\n    "timeStamp": 57,\\n    "src": [\\n\'', "printf '    ]\\n}\\n'"
    printed = subprocess.run(
        ["bash", "-c", "\n".join([head, *rows, tail])], capture_output=True, check=True, text=True
    )
    assert odas_text(SST) == printed.stdout
    potential = '        { "x": 1.000, "y": 0.000, "z": 0.000, "E": 0.250 }'
    assert odas_text(SSL).splitlines()[3:7] == [f"{potential},"] * 3 + [potential]
    assert len(json.loads(odas_text(SST))["src"]) == len(json.loads(odas_text(SSL))["src"]) == 4


def test_addresses_of_other_programs() -> None:
    assert read_address("--udp", "robot:9000") == Address("robot", 9000)
    assert read_address("--udp", "[::1]:80") == Address("::1", 80)
    assert read_address("--udp", "[::1]:80").text == "[::1]:80"
    for text in ("robot", "robot:", ":80", "robot:0", "robot:70000", "::1:80", "[]:80", "a:b"):
        with pytest.raises(InvalidOption, match="--udp must be HOST:PORT"):
            read_address("--udp", text)


def test_a_file_in_real_time_is_never_early_and_does_not_drift() -> None:
    clock = 100.0
    sent: list[float] = []

    def wait(seconds: float) -> None:
        nonlocal clock
        clock += seconds

    def now() -> float:
        return clock

    chunks = iter([np.zeros((160, 2), np.float32)] * 100)
    for index, _ in enumerate(paced(chunks, RATE, wait, now)):
        sent.append(clock)
        clock += 0.2 if index == 50 else 0.001  # the sender was held up once
    due = [100 + 0.01 * (index + 1) for index in range(100)]
    assert all(when >= at - 1e-9 for when, at in zip(sent, due, strict=True))
    assert sent[:51] == pytest.approx(due[:51])
    assert sent[-1] == pytest.approx(due[-1])


@pytest.fixture
def talker(tmp_path: Path, square: MicrophoneArray, plane_waves: Any) -> str:
    path = tmp_path / "talker.wav"
    soundfile.write(path, plane_waves(square, [60], seconds=2.0).T, RATE)
    return str(path)


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = main(["stream", *argv])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """The one line on standard error of a command that fails."""
    code, out, err = run(capsys, *argv)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


@pytest.fixture
def flags(real_service: str, talker: str) -> list[str]:
    return [talker, "--array", ARRAY, "--url", real_service, "--method", "norm_music"]


def test_a_file_gives_lines_of_json_rows_and_datagrams(
    flags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "out.csv"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(TIMEOUT_S)
        to = ["--udp", f"127.0.0.1:{listener.getsockname()[1]}", "--save", str(saved)]
        code, out, err = run(capsys, *flags, *to, "--interval-ms", "200", "--max-sources", "1")
        lines = [json.loads(line) for line in out.splitlines()]
        assert [json.loads(listener.recv(65_536)) for _ in lines] == lines
    assert code == 0
    assert np.diff([line["t_end"] for line in lines[:-1]]) == pytest.approx(0.2)
    found = [s["azimuth_deg"] for line in lines for s in line["sources"] if s["active"]]
    assert np.median(found) == pytest.approx(60, abs=3)
    rows = list(csv.DictReader(io.StringIO(saved.read_text())))
    assert [float(row["azimuth_deg"]) for row in rows] == [
        source["azimuth_deg"] for line in lines for source in line["sources"]
    ]
    assert err.splitlines()[-1].startswith("2.0 s of audio, ")


def test_yaw_and_sectors_are_those_of_the_robot(
    flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out, _ = run(capsys, *flags, "--yaw", "-90", "--output", "csv")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert np.median([float(r["azimuth_deg"]) for r in rows]) == pytest.approx(330, abs=3)
    _, out, _ = run(capsys, *flags, "--yaw", "-90", "--exclude=-40:-20")
    lines = [json.loads(line) for line in out.splitlines()]
    azimuths = [s["azimuth_deg"] for line in lines for s in line["sources"]]
    assert not [a for a in azimuths if 320 <= a <= 340]


def test_a_file_may_have_more_channels_than_microphones(
    flags: list[str], talker: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audio, _ = soundfile.read(talker, dtype="float32")
    shuffled = np.concatenate([audio[:, ::-1], np.zeros_like(audio[:, :1])], axis=1)
    wide = tmp_path / "wide.flac"
    soundfile.write(wide, shuffled, RATE)
    assert "name their channels" in refusal(capsys, str(wide), *flags[1:])
    _, out, _ = run(capsys, str(wide), *flags[1:], "--channel-map", "3,2,1,0", "--output", "csv")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert np.median([float(r["azimuth_deg"]) for r in rows]) == pytest.approx(60, abs=3)


class OdasReader:
    """A program such as odas_web, which listens until the sender closes."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._text = ""
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        peer, _ = self._listener.accept()
        with peer, peer.makefile(encoding="utf-8") as file:
            self._text = file.read()

    def text(self) -> str:
        self._thread.join(TIMEOUT_S)
        self._listener.close()
        return self._text


def objects(text: str) -> list[Any]:
    return [json.loads(part + "\n}") for part in text.split("\n}\n") if part]


def test_odas_objects_go_to_programs_that_listen(
    flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    tracks, potentials = OdasReader(), OdasReader()
    to = ["--odas-sst", tracks.address, "--odas-ssl", potentials.address, "--output", "odas"]
    code, out, _ = run(capsys, *flags, *to)
    written = tracks.text()
    assert (code, written) == (0, out)
    found = objects(written)
    assert all(len(one["src"]) == 4 for one in found)
    assert {tuple(source) for one in found for source in one["src"]} == {
        ("id", "tag", "x", "y", "z", "activity")
    }
    assert found[-1]["src"][0]["x"] == pytest.approx(0.5, abs=0.05)
    assert {tuple(s) for o in objects(potentials.text()) for s in o["src"]} == {
        ("x", "y", "z", "E")
    }
    _, out, _ = run(capsys, *flags, "--output", "odas", "--ssl")
    assert all("E" in one["src"][0] for one in objects(out))


def test_the_table_says_who_is_where_in_words() -> None:
    screen = io.StringIO()
    shown = LiveTable(Console(file=screen, width=100))
    warning = StreamWarning(seq=2, code="clipping", detail="channel 2 clips: turn it down")
    for event in (ready(), result(1, 10.0), warning, warning, result(3, 60.0, 270.0)):
        shown.show(event)
    shown.close()
    drawn = screen.getvalue()
    assert "square (channels 0, 1) by norm_music, session one" in drawn
    assert "0:00.8, 12 ms behind" in drawn
    rows = [line.split() for line in drawn.splitlines()]
    assert ["1", "60°", "front", "left", "0.90", "active"] in rows
    assert ["2", "270°", "right", "0.80", "active"] in rows
    assert not any("10°" in row for row in rows)
    assert "clipping: channel 2 clips: turn it down (2x)" in drawn


def test_the_table_shows_odas_tracks_silence_and_outages() -> None:
    screen = io.StringIO()
    shown = LiveTable(Console(file=screen, width=100))
    shown.show(SST)
    shown.show(Reconnecting("the connection to the service was lost", 0, 1.25))
    shown.close()
    rows = [line.split() for line in screen.getvalue().splitlines()]
    assert ["3", "300°", "front", "right", "0.90", "active"] in rows
    assert "was lost: next attempt in 1.2 s" in screen.getvalue()
    shown = LiveTable(Console(file=(screen := io.StringIO()), width=100))
    shown.show(result(1))
    shown.close()
    assert "12 ms behind, silence" in screen.getvalue()


def test_the_table_ends_with_the_summary(
    flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, *flags, "--output", "table")
    assert (code, err) == (0, "")
    assert "60° front left" in " ".join(out.split())
    assert out.splitlines()[-1].startswith("2.0 s of audio, ")


@pytest.mark.parametrize(
    ("argv", "reason"),
    [
        ([], "give a FILE, or record with --device"),
        (["x.wav", "--device", "array"], "give a FILE, or"),
        (["x.wav"], "give the --array"),
        (["none.wav", "--array", ARRAY], "none.wav: No such file"),
        (["--device", "x", "--array", ARRAY, "--realtime"], "--realtime is for files"),
        (["x.wav", "--array", ARRAY, "--ssl"], "--ssl goes with"),
        (["x.wav", "--array", ARRAY, "--output", "odas", "--save", "x.csv"], "run it twice"),
    ],
)
def test_wrong_combinations_are_one_sentence(
    argv: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, *argv)


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["--array", "respeaker"], "no array preset is called 'respeaker'"),
        (["--url", "ftp://robot"], "is no address"),
        (["--interval-ms", "5"], "output.interval_ms"),
        (["--exclude", "front"], "--exclude must be FROM:TO"),
        (["--exclude", "10:10"], "empty or the whole circle"),
        (["--client", "my robot"], "client"),
        (["--save", "out.txt"], "end its name in .jsonl or .csv"),
        (["--udp", "robot"], "--udp must be HOST:PORT"),
        (["--model", "none"], "no model is named 'none'"),
        (["--token-file", "none.key"], "none.key: No such file"),
    ],
)
def test_wrong_options_are_one_sentence(
    more: list[str], reason: str, flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, *flags, *more)


def test_nobody_at_the_other_end_is_one_sentence(
    flags: list[str], unused_tcp_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = f"127.0.0.1:{unused_tcp_port}"
    assert "nothing answers at ws://" in refusal(capsys, *flags, "--url", nobody)
    for option in ("--odas-sst", "--odas-ssl"):
        assert "it is the server" in refusal(capsys, *flags, option, nobody)


def test_a_session_that_fails_ends_with_its_sentence(
    service_of: Callable[..., ScriptedService], talker: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.hear()
        peer.say(result(1, 45.0), error("internal", 1011))
        peer.close(1011)

    url = service_of(script).url
    code, out, err = run(capsys, talker, "--array", ARRAY, "--url", url)
    assert (code, err) == (2, "error: because of internal\n")
    assert json.loads(out)["sources"][0]["azimuth_deg"] == 45.0


def test_an_unreadable_file_ends_with_its_sentence(
    flags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audio = np.zeros((RATE, 4), np.float32)
    audio[RATE // 2, 1] = np.nan
    soundfile.write(tmp_path / "nan.wav", audio, RATE, subtype="FLOAT")
    code, _, err = run(capsys, str(tmp_path / "nan.wav"), *flags[1:])
    assert code == 2
    assert "channel 1 is nan" in err.splitlines()[-1]


def test_calibration_comes_before_the_audio(
    service_of: Callable[..., ScriptedService], talker: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        assert peer.start["client"] == "r2"
        assert peer.control() == {"type": "calibrate", "kind": "noise", "seconds": 2.0}
        peer.audio_until("stop")
        peer.finish()

    url = service_of(script).url
    argv = [talker, "--array", ARRAY, "--url", url, "--client", "r2", "--calibrate", "2"]
    assert run(capsys, *argv)[0] == 0


def test_an_interrupted_stream_is_stopped_in_order(
    service_of: Callable[..., ScriptedService], talker: str
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.say(result(1, 45.0))
        peer.audio_until("stop")
        peer.finish()

    shown: list[Any] = []

    def show(event: Any) -> None:
        shown.append(event)
        if event == result(1, 45.0):
            raise KeyboardInterrupt

    source = FileSource(Path(talker), realtime=True)
    with StreamClient(service_of(script).url, array="square", audio=source.audio) as stream:
        assert follow(stream, source, show) == 130
    source.close()
    assert summary() in shown
    assert stream.summary == summary()


def test_control_c_ends_in_order(real_service: str, tmp_path: Path) -> None:
    long = tmp_path / "long.wav"
    soundfile.write(long, np.zeros((60 * RATE, 4), np.int16), RATE)
    program = "import sys; from service.cli import main; sys.exit(main(sys.argv[1:]))"
    argv = ["stream", str(long), "--array", ARRAY, "--url", real_service, "--realtime"]
    with subprocess.Popen(
        [sys.executable, "-c", program, *argv, "--method", "norm_music"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout
        assert process.stderr
        assert json.loads(process.stdout.readline())["sources"] == []
        process.send_signal(signal.SIGINT)
        out, err = process.stdout.read(), process.stderr.read()
        assert process.wait(TIMEOUT_S) == 130
    assert all(json.loads(line)["sources"] == [] for line in out.splitlines())
    assert " s of audio, " in err.splitlines()[-1]
    assert "Traceback" not in err


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
        peer.say(result(1, 45.0), error("session_limit", 4410))
        peer.close(4410)

    service = service_of(script)
    code, out, err = run(capsys, "--device", "ReSpeaker", "--array", ARRAY, "--url", service.url)
    assert (code, err) == (2, "error: because of session_limit\n")
    assert json.loads(out)["sources"][0]["azimuth_deg"] == 45.0
    start = service.peers[0].start
    assert start["audio"] == {
        "encoding": "pcm_s16le",
        "sample_rate": 16_000,
        "channels": 6,
        "header": "seq_time",
    }
    assert start["channel_map"] == [1, 2, 3, 4]
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
    assert "neuralmusic[microphone]" in refusal(capsys, *device)
    assert "neuralmusic[microphone]" in refusal(capsys, "--list-devices")
    (tmp_path / "sounddevice.py").write_text('raise OSError("PortAudio library not found")')
    monkeypatch.delitem(sys.modules, "sounddevice")
    monkeypatch.syspath_prepend(tmp_path)
    assert "libportaudio2" in refusal(capsys, *device)
