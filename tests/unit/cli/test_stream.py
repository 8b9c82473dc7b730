"""``neuralmusic stream`` as users meet it: files, interruption, errors in a sentence."""

from __future__ import annotations

import csv
import io
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scripted_service import TIMEOUT_S, Peer, ScriptedService, error, result, summary
from stream_command import ARRAY, RATE, refusal, run

from neuralmusic import StreamClient
from neuralmusic.cli.live import follow
from neuralmusic.protocol.framing import HEADER
from neuralmusic.protocol.server_messages import Result
from neuralmusic.sources.files import FileSource
from neuralmusic.sources.source import paced
from service.audio.pcm import decode_pcm


def test_a_file_in_real_time_is_never_early_and_does_not_drift() -> None:
    clock = 100.0
    sent: list[float] = []

    def wait(seconds: float) -> None:
        nonlocal clock
        clock += seconds

    def now() -> float:
        return clock

    chunks = iter([bytes(160 * 2 * 4)] * 100)
    for index, _ in enumerate(paced(chunks, RATE * 2 * 4, wait, now)):
        sent.append(clock)
        clock += 0.2 if index == 50 else 0.001  # the sender was held up once
    due = [100 + 0.01 * (index + 1) for index in range(100)]
    assert all(when >= at - 1e-9 for when, at in zip(sent, due, strict=True))
    assert sent[:51] == pytest.approx(due[:51])
    assert sent[-1] == pytest.approx(due[-1])


def test_yaw_and_sectors_are_those_of_the_robot(
    stream_flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out, _ = run(capsys, *stream_flags, "--yaw", "-90", "--output", "csv")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert np.median([float(r["azimuth_deg"]) for r in rows]) == pytest.approx(330, abs=3)
    _, out, _ = run(capsys, *stream_flags, "--yaw", "-90", "--exclude=-40:-20")
    lines = [json.loads(line) for line in out.splitlines()]
    azimuths = [s["azimuth_deg"] for line in lines for s in line["sources"]]
    assert not [a for a in azimuths if 320 <= a <= 340]


def test_a_file_may_have_more_channels_than_microphones(
    stream_flags: list[str], talk_wav: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    audio, _ = soundfile.read(talk_wav, dtype="float32")
    shuffled = np.concatenate([audio[:, ::-1], np.zeros_like(audio[:, :1])], axis=1)
    wide = tmp_path / "wide.flac"
    soundfile.write(wide, shuffled, RATE)
    assert "channel_map (--channel-map) with the 4" in refusal(capsys, str(wide), *stream_flags[1:])
    _, out, _ = run(
        capsys, str(wide), *stream_flags[1:], "--channel-map", "3,2,1,0", "--output", "csv"
    )
    rows = list(csv.DictReader(io.StringIO(out)))
    assert np.median([float(r["azimuth_deg"]) for r in rows]) == pytest.approx(60, abs=3)


@pytest.mark.parametrize(
    ("argv", "reason"),
    [
        ([], "give a FILE, or record with --device"),
        (["x.wav", "--device", "array"], "give a FILE, or"),
        (["x.wav"], "give the --array"),
        (["none.wav", "--array", ARRAY], "none.wav: No such file"),
        (["--device", "x", "--array", ARRAY, "--realtime"], "--realtime is for files"),
        (["-", "--array", ARRAY], "raw samples need --encoding"),
        (["x.wav", "--array", ARRAY, "--channels", "2"], "give - as the FILE"),
        (["x.wav", "--array", ARRAY, "--ssl"], "--ssl goes with"),
        (["x.wav", "--array", ARRAY, "--output", "odas", "--save", "x.csv"], "the command twice"),
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
        (["--url", "ftp://robot"], "is not an address"),
        (["--interval-ms", "5"], "output.interval_ms"),
        (["--exclude", "front"], "exclude_deg must list sectors as from:to"),
        (["--exclude", "10:10"], "empty or the whole circle"),
        (["--client", "my robot"], "client"),
        (["--save", "out.txt"], "end its name in .jsonl or .csv"),
        (["--udp", "robot"], "--udp must be HOST:PORT"),
        (["--model", "none"], "no model is named 'none'"),
        (["--key", "@none.key"], "none.key: No such file"),
    ],
)
def test_wrong_options_are_one_sentence(
    more: list[str], reason: str, stream_flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, *stream_flags, *more)


def test_nobody_at_the_other_end_is_one_sentence(
    stream_flags: list[str], unused_tcp_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = f"127.0.0.1:{unused_tcp_port}"
    assert "nothing answers at ws://" in refusal(capsys, *stream_flags, "--url", nobody)
    for option in ("--odas-sst", "--odas-ssl"):
        assert "it is the server" in refusal(capsys, *stream_flags, option, nobody)


def test_a_session_that_fails_ends_with_its_sentence(
    service_of: Callable[..., ScriptedService], talk_wav: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.audio_until("stop")
        peer.say(result(1, 45.0), error("internal", 1011))
        peer.close(1011)

    url = service_of(script).url
    code, out, err = run(capsys, talk_wav, "--array", ARRAY, "--url", url)
    assert (code, err) == (2, "error: because of internal\n")
    assert json.loads(out)["sources"][0]["azimuth_deg"] == 45.0


def test_unreadable_files_are_one_sentence(
    stream_flags: list[str],
    talk_wav: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    short, text = tmp_path / "short.wav", tmp_path / "notes.txt"
    short.write_bytes(Path(talk_wav).read_bytes()[:-100])
    text.write_text("no audio")
    assert "the header promises" in refusal(capsys, str(short), *stream_flags[1:])
    assert "not an audio file" in refusal(capsys, str(text), *stream_flags[1:])
    monkeypatch.setitem(sys.modules, "soundfile", None)
    assert "pip install './client[files]'" in refusal(capsys, str(text), *stream_flags[1:])


@pytest.mark.parametrize("subtype", ["PCM_16", "PCM_24", "PCM_32", "FLOAT"])
def test_a_wav_file_is_sent_as_it_is_stored(
    subtype: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "talk.wav"
    soundfile.write(path, np.random.default_rng(1).normal(0, 0.1, (RATE, 2)), RATE, subtype=subtype)
    sent: list[bytes] = []
    with monkeypatch.context() as robot:
        robot.setitem(sys.modules, "soundfile", None)
        source = FileSource(path, realtime=False)
        source.feed(sent.append, threading.Event())
        source.close()
    decoded = decode_pcm(b"".join(sent), source.audio["encoding"], 2, (0, 1))
    np.testing.assert_array_equal(decoded, soundfile.read(path, dtype="float32")[0].T)


def test_samples_on_standard_input_are_sent_whole(
    service_of: Callable[..., ScriptedService],
) -> None:
    heard: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.begin()
        heard.extend(peer.audio_until("stop"))
        peer.finish()

    service = service_of(script)
    samples = np.arange(4 * RATE // 10, dtype=np.int16).tobytes()
    raw = ["--encoding", "pcm_s16le", "--sample-rate", str(RATE), "--channels", "4"]
    argv = ["stream", "-", *raw, "--array", ARRAY, "--url", service.url]
    done = subprocess.run(
        [sys.executable, "-m", "neuralmusic", *argv],
        input=samples + b"x",  # what is no whole sample frame is left out
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, b"")
    assert service.peers[0].start["overflow"] == "drop_oldest"
    assert b"".join(message[HEADER.size :] for message in heard) == samples


def test_calibration_comes_before_the_audio(
    service_of: Callable[..., ScriptedService], talk_wav: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        assert peer.start["client"] == "r2"
        assert peer.control() == {"type": "calibrate", "kind": "noise", "seconds": 2.0}
        peer.audio_until("stop")
        peer.finish()

    url = service_of(script).url
    argv = [talk_wav, "--array", ARRAY, "--url", url, "--client", "r2", "--calibrate", "2"]
    assert run(capsys, *argv)[0] == 0


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C is heard, here and in processes that are started; background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Interrupting:
    """Ctrl-C while it is destroyed: Python prints an exception there and continues."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("interrupt", [lambda: signal.raise_signal(signal.SIGINT), Interrupting])
def test_an_interrupted_stream_is_stopped_in_order(
    service_of: Callable[..., ScriptedService], talk_wav: str, interrupt: Callable[[], object]
) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.say(result(1, 45.0))
        peer.audio_until("stop")
        peer.finish()

    shown: list[Any] = []

    def show(event: Any) -> None:
        shown.append(event)
        if isinstance(event, Result):
            interrupt()

    source = FileSource(Path(talk_wav), realtime=True)
    with StreamClient(service_of(script).url, array="square", audio=source.audio) as stream:
        assert follow(stream, source, show) == 130
    source.close()
    assert summary() in shown
    assert stream.summary == summary()


@pytest.mark.usefixtures("interruptible")
def test_control_c_ends_in_order(real_service: str, tmp_path: Path) -> None:
    long = tmp_path / "long.wav"
    soundfile.write(long, np.zeros((60 * RATE, 4), np.int16), RATE)
    program = "import sys; from neuralmusic.cli import main; sys.exit(main(sys.argv[1:]))"
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
