"""The service on Ray Serve: two replicas, one is killed, one is stopped, another is started."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from importlib import import_module
from itertools import cycle, takewhile
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
import yaml

pytest.importorskip("ray.serve", reason="needs Ray: pip install ./client '.[ray]'")

from command_line import run
from ray_cluster import Deployed, until

from neuralmusic import Backoff, LocalizationClient, Reconnecting, StreamClient
from neuralmusic.protocol.server_messages import Closing, Ready, Result
from service import ray_app
from service.doa.array import MicrophoneArray

pytestmark = pytest.mark.ray

RATE = 16_000
MESSAGE = 512
"""Sample frames"""
ENOUGH = 20
"""Requests in a row that must all be answered"""


class Robot:
    """A stream that says the same second again and again, until it is closed."""

    def __init__(self, url: str, array: MicrophoneArray, sound: Any) -> None:
        audio = {"encoding": "pcm_s16le", "sample_rate": RATE, "channels": 4}
        asked = {"array": array.name, "audio": audio, "method": "norm_music"}
        self.stream = StreamClient(url, backoff=Backoff(0.05, 0.5), **asked)
        self.events: list[Any] = []
        self._messages = cycle(np.array_split(sound, len(sound) // MESSAGE))

    def speak(self) -> None:
        """Send one message, read what has come."""
        self.stream.send(next(self._messages))
        self.events += self.stream.received()

    def of(self, kind: type) -> list[Any]:
        """The events of a kind so far."""
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def heard(self) -> bool:
        """True where the newest session has reported a talker; its first results have none yet."""
        session = takewhile(lambda event: not isinstance(event, Ready), reversed(self.events))
        results = (event for event in session if isinstance(event, Result))
        return any(source.active for result in results for source in result.sources)


@pytest.fixture
def robots(deployed: Deployed, square: MicrophoneArray, plane_waves: Any) -> Iterator[list[Robot]]:
    """Four robots whose talker is at 60 degrees, and who have heard him."""
    sound = (plane_waves(square, [60], seconds=1.024).T * 2**15).astype(np.int16)
    with ExitStack() as stack:
        started = [Robot(deployed.url, square, sound) for _ in range(4)]
        for robot in started:
            stack.enter_context(robot.stream)
        until(lambda: all(robot.heard for robot in started), lambda: speak(started))
        yield started


@pytest.fixture
def recording(square: MicrophoneArray, plane_waves: Any, tmp_path: Path) -> Path:
    path = tmp_path / "talker.wav"
    soundfile.write(path, plane_waves(square, [60], seconds=2.0).T, RATE)
    return path


def speak(robots: list[Robot]) -> None:
    for robot in robots:
        robot.speak()


def test_recordings_through_both_replicas(
    deployed: Deployed,
    square: MicrophoneArray,
    recording: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    answers: list[Any] = []
    with LocalizationClient(deployed.url) as client:
        until(
            lambda: all("POST /localize 200" in each.log for each in deployed.replicas()),
            lambda: answers.append(client.localize(recording, array=square.name)),
        )
    _, out, _ = run(capsys, "localize", str(recording), "--array", square.name, "--json")
    assert len(deployed.replicas()) == 2
    assert all(answer == json.loads(out) for answer in answers)


def test_an_open_stream_counts_as_a_request(deployed: Deployed, robots: list[Robot]) -> None:
    """So that Ray spreads streams evenly and starts replicas for them."""
    assert [replica.requests for replica in deployed.replicas()] == [2, 2]
    azimuths = [s.azimuth_deg for r in robots for e in r.of(Result) for s in e.sources if s.active]
    assert np.median(azimuths) == pytest.approx(60, abs=3)


def test_refusals_of_the_service_pass_the_proxy(deployed: Deployed, recording: Path) -> None:
    with httpx2.Client(base_url=deployed.url) as client:
        refused = client.post("/localize", params={"array": "none"}, content=recording.read_bytes())
    assert (refused.status_code, refused.json()["code"]) == (422, "array_unknown")


def test_a_replica_is_killed(deployed: Deployed, robots: list[Robot], recording: Path) -> None:
    before = {replica.pid for replica in deployed.replicas()}
    killed = deployed.replicas()[0].pid
    os.kill(killed, signal.SIGKILL)
    answers: list[Any] = []

    def go_on() -> None:
        speak(robots)
        answers.append(client.get("/models").status_code)

    def back() -> bool:
        now = {replica.pid for replica in deployed.replicas()}
        return len(now) == 2 and killed not in now

    with httpx2.Client(base_url=deployed.url) as client:
        until(back, go_on)
        until(lambda: len(answers) > ENOUGH and all(r.heard for r in robots), go_on)
    assert before - {replica.pid for replica in deployed.replicas()} == {killed}
    assert set(answers) == {200}
    lost = [robot for robot in robots if robot.of(Reconnecting)]
    assert len(lost) == 2
    for robot in robots:
        sessions = {ready.session for ready in robot.of(Ready)}
        assert len(sessions) == (2 if robot in lost else 1)


def test_a_stopped_replica_closes_its_streams_in_order(
    deployed: Deployed, robots: list[Robot]
) -> None:
    deployed.deploy(num_replicas=1, autoscaling_config=None)
    until(
        lambda: all(robot.of(Reconnecting) and robot.heard for robot in robots),
        lambda: speak(robots),
    )
    for robot in robots:
        assert {closing.code for closing in robot.of(Closing)} == {"draining"}
        assert all("shutting down" in each.reason for each in robot.of(Reconnecting))


def test_open_streams_start_another_replica(deployed: Deployed, robots: list[Robot]) -> None:
    deployed.deploy(num_replicas=1, autoscaling_config=None)
    scaling = {"min_replicas": 1, "max_replicas": 2, "target_ongoing_requests": 2}
    deployed.deploy(autoscaling_config={**scaling, "upscale_delay_s": 0.5})
    assert len(deployed.replicas()) == 1
    until(lambda: len(deployed.replicas()) == 2, lambda: speak(robots))
    until(lambda: all(robot.heard for robot in robots), lambda: speak(robots))


def test_the_documented_configuration_is_ray_s(cluster: None) -> None:
    from ray.serve.schema import ServeDeploySchema

    text = (Path(__file__).parents[2] / "docs" / "scale-out.md").read_text()
    (block,) = [each for each in text.split("```yaml\n") if "import_path:" in each]
    configured = ServeDeploySchema.model_validate(yaml.safe_load(block.split("```")[0]))
    (application,) = configured.applications
    module, _, name = application.import_path.partition(":")
    assert getattr(import_module(module), name) is ray_app.app
    assert [each.name for each in application.deployments] == [ray_app.deployment.name]
