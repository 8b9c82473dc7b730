"""What is released, in fresh environments: a robot streams and localizes on every Python."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest
from fresh_environment import Environment, create, pythons

pytestmark = pytest.mark.dist

VERSIONS = ("3.9", "3.10", "3.11", "3.12", "3.13")
MOST_DISTRIBUTIONS = 10
MOST_BYTES = 25_000_000
UNWANTED = {
    "numpy", "scipy", "onnxruntime", "fastapi", "starlette", "uvicorn", "rich", "soundfile",
    "sounddevice", "httpx",
}  # fmt: skip
ARRAY = "respeaker-usb-4mic-v2"
TALKERS_DEG = (45.0, 200.0)

STREAMING = """
import sys, wave
from neuralmusic import StreamClient
path, array, url = sys.argv[1:]
with wave.open(path) as file:
    audio = {"encoding": "pcm_s16le", "sample_rate": file.getframerate(), "channels": 4}
    with StreamClient(url, array=array, audio=audio, overflow="block") as stream:
        while True:
            chunk = file.readframes(1600)
            if not chunk:
                break
            stream.send(chunk)
        print(*[source.azimuth_deg for source in stream.stop().sources])
"""
LOCALIZING = """
import asyncio, sys
from neuralmusic import AsyncLocalizationClient, LocalizationClient
path, array, url = sys.argv[1:]
with LocalizationClient(url) as client:
    answer = client.localize(path, array=array)
async def again():
    async with AsyncLocalizationClient(url) as client:
        return await client.localize(path, array=array)
assert asyncio.run(again()) == answer
print(*[source["azimuth_deg"] for source in answer["summary"]["sources"]])
"""


@pytest.fixture(scope="module", params=VERSIONS)
def robot(
    request: pytest.FixtureRequest, client_wheel: str, tmp_path_factory: pytest.TempPathFactory
) -> Environment:
    """A fresh environment with the client, on one Python after the other."""
    python = pythons().get(request.param)
    if python is None:
        pytest.skip(f"there is no Python {request.param} here")
    environment = create(python, tmp_path_factory.mktemp("robot"))
    environment.install(client_wheel)
    return environment


def assert_talkers(printed: str) -> None:
    """Directions of the sample's two talkers are among those printed."""
    found = [float(word) for word in printed.split()]
    for azimuth in TALKERS_DEG:
        assert min(abs((each - azimuth + 180) % 360 - 180) for each in found) < 6, found


def test_a_robot_needs_little(robot: Environment) -> None:
    installed = robot.distributions()
    assert len(installed) <= MOST_DISTRIBUTIONS, installed
    assert sum(installed.values()) <= MOST_BYTES, installed
    assert not UNWANTED & {name.lower() for name in installed}


def test_a_robot_streams(robot: Environment, sample_wav: Path, service_url: str) -> None:
    done = robot.run("python", "-W", "error", "-c", STREAMING, str(sample_wav), ARRAY, service_url)
    assert done.stderr == ""
    assert_talkers(done.stdout)


def test_a_robot_streams_from_the_command_line(
    robot: Environment, sample_wav: Path, service_url: str
) -> None:
    argv = ("stream", str(sample_wav), "--array", ARRAY, "--url", service_url)
    done = robot.run("neuralmusic", *argv)
    assert done.returncode == 0, done.stderr
    results = [json.loads(line) for line in done.stdout.splitlines()]
    azimuths = [source["azimuth_deg"] for each in results for source in each["sources"]]
    assert_talkers(" ".join(map(str, azimuths)))
    lines = robot.run("neuralmusic", *argv, "--output", "table").stdout.splitlines()
    assert ARRAY in lines[0]
    assert " s of audio, " in lines[-1]
    assert any("front left (id " in line for line in lines)


def test_a_robot_has_its_own_commands_and_hears_of_the_others(robot: Environment) -> None:
    assert ARRAY in robot.run("neuralmusic", "arrays").stdout
    assert "22.85" in robot.run("neuralmusic", "arrays", ARRAY).stdout
    assert "neuralmusic-service adds serve" in robot.run("neuralmusic", "--help").stdout
    missing = robot.run("neuralmusic", "serve")
    assert (missing.returncode, missing.stderr.count("\n")) == (2, 1)
    assert "comes with the package neuralmusic-service" in missing.stderr
    assert (
        "pip install './client[http]'" in robot.run("python", "-c", LOCALIZING, "", "", "").stderr
    )


def test_a_robot_localizes_with_the_extra(
    robot: Environment, client_wheel: str, sample_wav: Path, service_url: str
) -> None:
    robot.install(f"{client_wheel}[http]")
    done = robot.run("python", "-W", "error", "-c", LOCALIZING, str(sample_wav), ARRAY, service_url)
    assert done.stderr == ""
    assert_talkers(done.stdout)


def test_wheels_and_sdists_hold_what_they_should(built: Path) -> None:
    (client,) = built.glob("neuralmusic-*.whl")
    (service,) = built.glob("neuralmusic_service-*.whl")
    assert {name.split("/")[0].split("-")[0] for name in ZipFile(client).namelist()} == {
        "neuralmusic"
    }
    held = ZipFile(service).namelist()
    assert {name.split("/")[0].split("-")[0] for name in held} == {
        "service", "neuralmusic_service",
    }  # fmt: skip
    for wanted in ("service/py.typed", "service/models/any-array/bundle.json"):
        assert wanted in held
    assert "neuralmusic/py.typed" in ZipFile(client).namelist()
    for sdist in built.glob("*.tar.gz"):
        with tarfile.open(sdist) as archive:
            names = {"/".join(name.split("/")[1:]) for name in archive.getnames()}
        assert {"pyproject.toml", "README.md", "LICENSE", "PKG-INFO"} <= names
        assert not any(name.startswith(("tests", "docs", "model_export")) for name in names)


def test_an_unsupported_python_is_told_so(built: Path, client_wheel: str, tmp_path: Path) -> None:
    old = next((path for version, path in pythons().items() if version in ("3.9", "3.10")), None)
    if old is None:
        pytest.skip("there is no Python here that is too old for the service")
    (wheel,) = built.glob("neuralmusic_service-*.whl")
    done = create(old, tmp_path).pip(client_wheel, str(wheel))
    errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    assert len(errors) == 1
    assert "'neuralmusic-service' requires a different Python" in errors[0]
    assert ">=3.11" in errors[0]
