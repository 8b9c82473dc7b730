"""The wheels as they are released, and a service that runs from them alone."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import soundfile
from fresh_environment import clean, create
from source_tree import ROOT


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist of the client and of the service."""
    folder = tmp_path_factory.mktemp("dist")
    for project in ("client", "."):
        done = subprocess.run(
            [sys.executable, "-m", "build", "--outdir", folder, ROOT / project],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="session")
def client_wheel(built: Path) -> str:
    (wheel,) = built.glob("neuralmusic-*.whl")
    return str(wheel)


@pytest.fixture(scope="session")
def service_url(
    built: Path, client_wheel: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    """The address of a service in an environment that has the wheels and what they need."""
    (wheel,) = built.glob("neuralmusic_service-*.whl")
    environment = create(sys.executable, tmp_path_factory.mktemp("service"))
    # Compiling scipy takes longer than the tests, which import a tenth of it.
    environment.install("--no-compile", client_wheel, str(wheel))
    with subprocess.Popen(
        [environment.folder / "bin" / "neuralmusic", "serve", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=environment.folder,
        env=clean(),
    ) as process:
        try:
            assert process.stdout is not None
            yield re.findall(r"http://\S+", process.stdout.readline())[0]
        finally:
            process.terminate()


@pytest.fixture(scope="session")
def sample_wav(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample recording as WAV, which a robot reads without any library."""
    samples, rate = soundfile.read(ROOT / "examples" / "two-talkers.flac", dtype="int16")
    path = tmp_path_factory.mktemp("sample") / "two-talkers.wav"
    soundfile.write(path, samples, rate)
    return path
