"""compose.yaml as a newcomer starts it: the sample is localized, a shutdown is in order."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
import soundfile
from container_engine import ROOT, run
from container_images import SERVICE
from running_containers import ARRAY, SAMPLE, TALKERS_DEG, ComposeProject, wait_for
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import ClientConnection, connect

pytestmark = pytest.mark.docker

PATIENCE_S = 30.0


@pytest.fixture
def one(image: str) -> Iterator[ComposeProject]:
    """One replica that is ready."""
    assert image == SERVICE
    with ComposeProject("one", "compose.yaml") as project:
        project.up()
        wait_for(f"{project.url('neuralmusic', 8000)}/readyz")
        yield project


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_the_readme_s_line_finds_the_sample_s_talkers(one: ComposeProject) -> None:
    (line,) = re.findall(r"^curl -s -F audio=.*/localize$", (ROOT / "README.md").read_text(), re.M)
    url = one.url("neuralmusic", 8000)
    answer = json.loads(run(*shlex.split(re.sub(r"http://[^/]+", url, line))))
    found = sorted(source["azimuth_deg"] for source in answer["summary"]["sources"])
    assert found == pytest.approx(TALKERS_DEG, abs=4.0)


def test_a_running_stream_gets_its_summary_and_its_closing_on_shutdown(one: ComposeProject) -> None:
    (replica,) = one.containers("neuralmusic")
    audio, rate = soundfile.read(SAMPLE, dtype="int16")
    start = {
        "type": "start",
        "audio": {"encoding": "pcm_s16le", "sample_rate": rate, "channels": 4},
        "array": {"name": ARRAY},
        "overflow": "block",
    }
    address = one.url("neuralmusic", 8000, "ws") + "/stream"
    with connect(address, subprotocols=["doa.v1"]) as stream:  # type: ignore[list-item]
        stream.send(json.dumps(start))
        for begin in range(0, rate, rate // 10):
            stream.send(audio[begin : begin + rate // 10].tobytes())
        until(stream, "result")
        one.compose("kill", "-s", "SIGTERM", "neuralmusic")
        summary, closing = until(stream, "summary"), until(stream, "closing")
        with pytest.raises(ConnectionClosedError):
            stream.recv(PATIENCE_S)
    assert (closing["code"], stream.close_code) == ("draining", 1012)
    assert summary["audio_s"] == pytest.approx(1.0)
    assert replica.wait() == 0


def test_a_bundle_that_is_added_serves_after_a_hang_up(image: str, tmp_path: Path) -> None:
    models = tmp_path / "models"
    models.mkdir()
    for folder in (tmp_path, models):
        folder.chmod(0o755)  # the container's user is another one
    with ComposeProject("reload", "compose.yaml", NEURALMUSIC_MODELS=models) as project:
        project.up()
        url = project.url("neuralmusic", 8000)
        wait_for(f"{url}/readyz")
        assert "mine" not in loaded(url)
        embedded = ROOT / "service" / "models" / "any-array"
        shutil.copytree(embedded, models / ".mine")
        manifest = json.loads((embedded / "bundle.json").read_text())
        (models / ".mine" / "bundle.json").write_text(json.dumps({**manifest, "name": "mine"}))
        (models / ".mine").rename(models / "mine")
        project.compose("kill", "-s", "HUP", "neuralmusic")
        deadline = time.monotonic() + PATIENCE_S
        while "mine" not in loaded(url) and time.monotonic() < deadline:
            pass
        assert loaded(url)[0] == "mine"


def loaded(url: str) -> list[str]:
    """The names of a service's models."""
    return [model["name"] for model in httpx2.get(f"{url}/models").json()["models"]]


def until(stream: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of a type."""
    while True:
        message: dict[str, Any] = json.loads(stream.recv(PATIENCE_S))
        if message["type"] == kind:
            return message


def test_noise_profiles_outlive_the_container(one: ComposeProject) -> None:
    """The volume belongs to the service's user: what is written is there after a new start."""
    (before,) = one.containers("neuralmusic")
    before.run("sh", "-c", "echo kept > /noise/note")
    one.compose("up", "-d", "--force-recreate")
    (after,) = one.containers("neuralmusic")
    assert after.id != before.id
    assert after.run("cat", "/noise/note").strip() == "kept"
