"""Noise profiles over HTTP: stored, listed, downloaded, used and deleted."""

from __future__ import annotations

import errno
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from fastapi.testclient import TestClient

from neuralmusic.cli import main
from service.app import create_app
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.whitening import learn_noise
from service.inference.noise_profile import MAX_BYTES, load_noise, noise_bytes
from service.inference.noise_store import NoiseStore
from service.observability.logs import RareLine
from service.settings import Settings

from .conftest import ARRAY, Localize, Sounds

MOTOR = 200.0


def mixture(sounds: Sounds, azimuth: float, seed: int = 1) -> bytes:
    """A plane wave and a motor as loud."""
    wave, motor = sounds.plane_wave(azimuth, seed=seed), sounds.plane_wave(MOTOR, seed=seed + 50)
    return sounds.file(0.5 * (wave + motor))


@pytest.fixture(scope="module")
def profile(sounds: Sounds) -> bytes:
    audio = sounds.plane_wave(MOTOR, seconds=5.0, seed=99).T
    return noise_bytes(learn_noise([audio], preset(ARRAY), Stft()))


@pytest.fixture
def stored(client: TestClient, profile: bytes) -> Iterator[str]:
    answer = client.put("/noise/motor", content=profile)
    assert answer.status_code == 200
    yield "motor"
    client.delete("/noise/motor")


def test_a_stored_profile_is_listed_and_downloaded(
    client: TestClient, stored: str, profile: bytes
) -> None:
    (listed,) = client.get("/noise").json()["noise"]
    assert listed["name"] == "motor"
    assert listed["array"] == ARRAY
    assert listed["positions_m"] == preset(ARRAY).positions.tolist()
    assert listed["seconds"] == pytest.approx(5.0, abs=0.05)
    assert listed["created"].endswith("Z")
    answer = client.get("/noise/motor")
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"] == 'attachment; filename="motor.npz"'
    assert answer.content == profile


def test_a_deleted_profile_is_gone(client: TestClient, profile: bytes) -> None:
    client.put("/noise/gone", content=profile)
    assert client.delete("/noise/gone").status_code == 204
    for answer in (client.get("/noise/gone"), client.delete("/noise/gone")):
        assert answer.status_code == 404
        assert answer.json()["code"] == "not_found"


@pytest.mark.parametrize("method", ["put", "delete"])
def test_a_disk_that_refuses_is_named_to_the_operator_alone(
    client: TestClient,
    profile: bytes,
    monkeypatch: pytest.MonkeyPatch,
    written_log: io.StringIO,
    method: str,
) -> None:
    monkeypatch.setattr("service.api.upload.told", RareLine(logging.getLogger("service")))
    refuses = OSError(errno.EROFS, "Read-only file system", "/operators/folder")
    monkeypatch.setattr(NoiseStore, method, Mock(side_effect=refuses))
    for _ in range(9):
        answer = client.request(method, "/noise/robot", content=profile)
        assert (answer.status_code, answer.json()["code"]) == (503, "disk_full")
        assert "log says why" in answer.json()["detail"]
        assert "operators" not in answer.text
    lines = [line for line in written_log.getvalue().splitlines() if "/operators/folder" in line]
    assert len(lines) == 2  # as text and as JSON


@pytest.mark.parametrize("method", ["neural", "norm_music", "srp_phat"])
def test_a_known_motor_is_no_source(
    method: str, stored: str, localize: Localize, sounds: Sounds
) -> None:
    motor = sounds.wav(MOTOR, seed=5, seconds=3.0)
    assert localize.raw(motor, method=method).json()["summary"]["sources"]
    answer = localize.raw(motor, method=method, noise=stored).json()
    assert answer["summary"]["sources"] == []


def test_a_talker_beside_a_known_motor_is_found(
    stored: str, localize: Localize, sounds: Sounds
) -> None:
    body = mixture(sounds, 77.0)
    answer = localize.form(body, noise=stored, num_sources=1, method="norm_music").json()
    assert answer["summary"]["sources"][0]["azimuth_deg"] == pytest.approx(77.0, abs=5)


def test_an_unknown_profile_and_one_of_another_array_are_refused(
    stored: str, localize: Localize, sounds: Sounds
) -> None:
    unknown = localize.raw(sounds.wav(), noise="fans")
    assert (unknown.status_code, unknown.json()["code"]) == (422, "noise_unknown")
    assert "stored are motor" in unknown.json()["detail"]
    other = localize.raw(sounds.wav(), noise=stored, array="respeaker-4mic-hat")
    assert (other.status_code, other.json()["code"]) == (422, "noise_mismatch")


@pytest.mark.parametrize(
    ("name", "content", "status", "code"),
    [
        ("fans", b"", 422, "noise_invalid"),
        ("fans", b"RIFF not a profile", 422, "noise_invalid"),
        ("a b", None, 422, "option_invalid"),
        (".hidden", None, 422, "option_invalid"),
        ("x" * 65, None, 422, "option_invalid"),
        ("..%2Ffans", None, 404, "not_found"),
    ],
)
def test_what_cannot_be_stored_is_refused(
    client: TestClient, profile: bytes, name: str, content: bytes | None, status: int, code: str
) -> None:
    answer = client.put(f"/noise/{name}", content=profile if content is None else content)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert client.get("/noise").json() == {"noise": []}


def test_a_large_profile_is_refused(profile: bytes) -> None:
    settings = Settings(workers=1, max_upload_bytes=2**26)
    with TestClient(create_app(settings)) as running:
        answer = running.put("/noise/fans", content=bytes(MAX_BYTES + 1))
    assert (answer.status_code, answer.json()["code"]) == (413, "upload_too_large")


def test_profiles_in_the_folder_of_the_settings_outlive_the_process(
    profile: bytes, tmp_path: Path
) -> None:
    settings = Settings(workers=1, noise_folder=tmp_path)
    with TestClient(create_app(settings)) as running:
        running.put("/noise/fans", content=profile)
    with TestClient(create_app(settings)) as running:
        assert running.get("/noise/fans").content == profile


def test_the_command_learns_what_the_service_takes(
    client: TestClient, sounds: Sounds, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, written = tmp_path / "motor.wav", tmp_path / "motor.npz"
    recording.write_bytes(sounds.wav(MOTOR, seconds=5.0))
    assert main(["noise", str(recording), "--array", ARRAY, "-o", str(written)]) == 0
    assert "learnt from" in capsys.readouterr().out
    assert client.put("/noise/cli", content=written.read_bytes()).status_code == 200
    client.delete("/noise/cli")
    noise = load_noise(io.BytesIO(written.read_bytes()))
    assert np.allclose(noise.array.positions, preset(ARRAY).positions)
    options = ["--array", ARRAY, "--method", "srp_phat", "--json"]
    assert main(["localize", str(recording), *options, "--noise", str(written)]) == 0
    assert '"summary":{"sources":[]}' in capsys.readouterr().out.replace(" ", "").replace("\n", "")


def test_the_command_says_what_is_wrong(
    sounds: Sounds, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "short.wav"
    recording.write_bytes(sounds.wav(MOTOR, seconds=0.5))
    assert main(["noise", str(recording), "--array", ARRAY, "-o", str(tmp_path / "n.npz")]) == 2
    assert "too few" in capsys.readouterr().err
    assert not (tmp_path / "n.npz").exists()
    options = ["localize", str(recording), "--array", ARRAY]
    assert main([*options, "--noise", str(recording)]) == 2
    assert "not a noise profile" in capsys.readouterr().err
