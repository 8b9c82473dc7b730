"""The image: what is in it and what is not, and that it needs no more than it says."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import httpx2
import numpy as np
import pytest
import soundfile
from container_engine import ROOT, docker
from container_images import size_bytes
from running_containers import ARRAY, SAMPLE, TALKERS_DEG, Container, wait_for

from neuralmusic import LocalizationClient

pytestmark = pytest.mark.docker

RunContainer = Callable[..., Container]
MOST_BYTES = 450_000_000
UNWANTED = "gcc cc g++ clang ld make pip pip3 git curl wget"


def inside(image: str, *words: str) -> str:
    """What a program of the image prints."""
    return docker("run", "--rm", "--entrypoint", words[0], image, *words[1:]).strip()


def large_wav() -> bytes:
    """The sample twice, 2 MB: more than is kept in memory while it comes."""
    samples, rate = soundfile.read(SAMPLE, dtype="int16")
    file = io.BytesIO()
    soundfile.write(file, np.concatenate([samples, samples]), rate, format="WAV")
    return file.getvalue()


def directions(url: str, recording: Path | bytes) -> list[float]:
    """The azimuths of a recording's summary, in degrees."""
    with LocalizationClient(url) as client:
        answer = client.localize(recording, array=ARRAY)
    return sorted(source["azimuth_deg"] for source in answer["summary"]["sources"])


def test_it_holds_no_compiler_no_installer_and_no_training_code(image: str) -> None:
    found = inside(image, "sh", "-c", f"for each in {UNWANTED}; do command -v $each; done; true")
    assert found == ""
    ours = ("service", "neuralmusic")
    names = ("torch", "model_export", "pip", "pytest", "matplotlib", "onnx", *ours)
    ask = f"import importlib.util as u; print(*[n for n in {names} if u.find_spec(n)])"
    assert inside(image, "python3", "-c", ask) == "service neuralmusic"


def test_it_is_small(image: str) -> None:
    assert size_bytes(image) < MOST_BYTES


def test_it_says_who_runs_how_it_is_checked_and_how_it_is_stopped(image: str) -> None:
    config = json.loads(docker("image", "inspect", image))[0]["Config"]
    assert config["User"] == "10001:10001"
    assert config["StopSignal"] == "SIGTERM"
    assert config["Healthcheck"]["Test"][-1].endswith("ready.py")
    assert config["Labels"]["org.opencontainers.image.licenses"] == "Apache-2.0"


def test_without_rights_and_with_a_root_that_is_read_only_it_localizes(
    run_container: RunContainer,
) -> None:
    hardened = ("--cap-drop", "ALL", "--security-opt", "no-new-privileges:true")
    running = run_container("--read-only", "--tmpfs", "/tmp", *hardened)
    wait_for(f"{running.url}/readyz")
    np.testing.assert_allclose(directions(running.url, SAMPLE), TALKERS_DEG, atol=4.0)
    np.testing.assert_allclose(directions(running.url, large_wav()), TALKERS_DEG, atol=4.0)
    assert running.run("id", "-u").strip() == "10001"
    assert running.run("find", "/tmp", "-type", "f").strip() == ""


def test_it_is_checked_by_its_readiness(run_container: RunContainer) -> None:
    running = run_container("--health-interval", "200ms")
    wait_for(f"{running.url}/readyz")
    while (health := running.facts["State"]["Health"])["Status"] == "starting":
        pass
    assert health["Status"] == "healthy"
    # The check can fail: it looks where the service says that it listens.
    with pytest.raises(AssertionError, match="not reachable"):
        docker("exec", "-e", "NEURALMUSIC_PORT=9", running.id, *health_command(running))


def health_command(running: Container) -> list[str]:
    command: list[str] = running.facts["Config"]["Healthcheck"]["Test"][1:]
    return command


def test_models_are_taken_from_the_folder_where_one_is_mounted(
    run_container: RunContainer, tmp_path: Path
) -> None:
    folder = tmp_path / "models" / "mine"
    shutil.copytree(ROOT / "service" / "models" / "any-array", folder)
    manifest = json.loads((folder / "bundle.json").read_text())
    (folder / "bundle.json").write_text(json.dumps({**manifest, "name": "mine"}))
    tmp_path.chmod(0o755)  # the container's user is another one
    running = run_container("-v", f"{tmp_path / 'models'}:/models:ro")
    wait_for(f"{running.url}/readyz")
    names = [model["name"] for model in httpx2.get(f"{running.url}/models").json()["models"]]
    assert names[0] == "mine"
    assert "any-array" in names


def test_a_bundle_that_is_corrupt_ends_it_with_a_sentence(
    run_container: RunContainer, tmp_path: Path
) -> None:
    folder = tmp_path / "models" / "mine"
    shutil.copytree(ROOT / "service" / "models" / "any-array", folder)
    with (folder / "fusion.npz").open("ab") as file:
        file.write(b"0")
    tmp_path.chmod(0o755)
    running = run_container("-v", f"{tmp_path / 'models'}:/models:ro")
    assert running.wait() == 2
    assert "fusion.npz" in running.logs()


def test_it_ends_well_and_at_once_when_nothing_is_to_be_done(run_container: RunContainer) -> None:
    running = run_container("--init")
    wait_for(f"{running.url}/readyz")
    assert running.stop() == 0


def test_it_ends_well_as_the_first_process_too(run_container: RunContainer) -> None:
    running = run_container()
    wait_for(f"{running.url}/readyz")
    assert running.stop() == 0
