"""Clients that are written from ``docs/protocol.md`` alone, in C++ and Python, hear the sample."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median

import pytest
import soundfile
from key_file import KeyFile
from running_service import RunningService
from source_tree import ROOT

from service.settings import Settings

pytestmark = pytest.mark.dist

EXAMPLES = ROOT / "examples"
CPP = EXAMPLES / "stream_client.cpp"
ARRAY = "respeaker-usb-4mic-v2"
TALKERS_DEG = (45.0, 200.0)
HEADERS = "#include <boost/beast/version.hpp>\n#include <nlohmann/json_fwd.hpp>\n"
PATIENCE = 300
"""Seconds until a compiler or a client hangs"""


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    running = RunningService(workers_ahead=True)
    yield running
    running.stop()


@pytest.fixture(scope="module")
def talk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample recording as a WAV file."""
    samples, rate = soundfile.read(EXAMPLES / "two-talkers.flac", dtype="int16")
    path = tmp_path_factory.mktemp("talk") / "talk.wav"
    soundfile.write(path, samples, rate)
    return path


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The example in C++, built as its first lines say."""
    if shutil.which("c++") is None:
        pytest.skip("needs the compiler c++")
    check = ["c++", "-std=c++17", "-fsyntax-only", "-x", "c++", "-"]
    if subprocess.run(check, input=HEADERS, text=True, capture_output=True).returncode:
        pytest.skip("needs the headers of Boost.Beast and nlohmann-json")
    built = tmp_path_factory.mktemp("built") / "stream_client"
    words = shlex.split(build_line().replace("-O2", "-Wall -Wextra -Werror"))
    words[words.index("stream_client")] = str(built)
    subprocess.run(words, cwd=ROOT, check=True, timeout=PATIENCE)
    return str(built)


def build_line() -> str:
    (line,) = re.findall(r"^// Build: (.*)$", CPP.read_text(), re.MULTILINE)
    return str(line)


def heard(command: Sequence[str], audio: bytes | None = None) -> list[float]:
    """The median azimuth of every id that a client has printed, in the order of their ids."""
    done = subprocess.run(
        command, input=audio, capture_output=True, check=False, timeout=PATIENCE, cwd="/"
    )
    printed = done.stdout.decode()
    assert (done.returncode, done.stderr) == (0, b"")
    azimuths: dict[str, list[float]] = defaultdict(list)
    for source, azimuth in re.findall(r" s  id (\d+)  ([\d.]+) degrees", printed):
        azimuths[source].append(float(azimuth))
    assert printed.count("track ") == len(azimuths)
    return [median(azimuths[source]) for source in sorted(azimuths)]


@pytest.mark.parametrize("pace", [(), ("--fast",)], ids=["real time", "fast"])
def test_the_client_in_cpp_hears_the_talkers_of_a_file(
    program: str, talk: Path, service: RunningService, pace: Sequence[str]
) -> None:
    command = (program, *pace, "--port", str(service.port), ARRAY, str(talk))
    assert heard(command) == pytest.approx(TALKERS_DEG, abs=4)


def test_the_client_in_cpp_hears_the_talkers_of_a_pipe(
    program: str, talk: Path, service: RunningService
) -> None:
    samples, rate = soundfile.read(talk, dtype="int16")
    command = (program, "--fast", "--port", str(service.port), ARRAY, "-", str(rate), "4")
    assert heard(command, samples.tobytes()) == pytest.approx(TALKERS_DEG, abs=4)


def test_the_client_in_cpp_says_why_a_session_was_refused(
    program: str, talk: Path, service: RunningService
) -> None:
    command = (program, "--port", str(service.port), "nobody-s", str(talk))
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 1
    assert "array_unknown" in done.stderr
    assert ARRAY in done.stderr


def test_the_client_in_cpp_says_what_the_handshake_was_refused_for(
    program: str, talk: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keys = KeyFile(tmp_path / "keys.jsonl")
    token = keys.add("stream")
    guarded = RunningService(settings=Settings(workers=1, keys=keys.path))
    command = (program, "--fast", "--port", str(guarded.port), ARRAY, str(talk))
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "key_missing" in done.stderr
        monkeypatch.setenv("NEURALMUSIC_KEY", token)
        assert len(heard(command)) == len(TALKERS_DEG)
    finally:
        guarded.stop()


def test_the_client_in_python_hears_the_talkers(talk: Path, service: RunningService) -> None:
    client = EXAMPLES / "raw_stream.py"
    assert not re.search(r"(import|from) (neuralmusic|service)", client.read_text())
    address = f"ws://127.0.0.1:{service.port}/stream"
    command = (sys.executable, str(client), str(talk), ARRAY, address)
    assert heard(command) == pytest.approx(TALKERS_DEG, abs=4)


def test_the_documents_build_it_as_its_first_lines_say() -> None:
    assert build_line() in (EXAMPLES / "README.md").read_text()
