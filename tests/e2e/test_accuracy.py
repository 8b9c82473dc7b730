"""Accuracy through the HTTP interface on simulated rooms with synthetic voices."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from starlette.testclient import TestClient

from model_export.simulation.protocol import SceneProtocol, SimulatedScene, simulate_scene
from model_export.simulation.rooms import RoomSpec
from model_export.simulation.synthesis import synthetic_voice
from service.app import create_app
from service.settings import Settings

SCENES = 12


@pytest.fixture(scope="module")
def client():
    with TestClient(create_app(Settings())) as client:
        yield client


@pytest.fixture(scope="module")
def voices() -> list[np.ndarray]:
    rng = np.random.default_rng(8)
    return [synthetic_voice(rng, 1.1) for _ in range(8)]


def localize(client: TestClient, scene: SimulatedScene, **options: object) -> dict:
    file = io.BytesIO()
    soundfile.write(file, 0.1 * scene.audio.T, 16000, format="WAV", subtype="PCM_16")
    response = client.post(
        "/localize", params={"array": scene.array.name, **options},
        content=file.getvalue(), headers={"content-type": "audio/wav"},
    )  # fmt: skip
    assert response.status_code == 200, response.text
    return response.json()


@pytest.mark.parametrize(
    "protocol",
    [
        SceneProtocol(),
        SceneProtocol(array="respeaker-6mic-circular", snr_db=15.0),
        SceneProtocol(room=RoomSpec((5.0, 4.0, 2.8), (2.2, 1.8, 1.1), rt60=0.35), snr_db=20.0),
    ],
    ids=["paper", "ring", "reverberant"],
)
def test_one_talker_within_three_degrees(client, voices, protocol: SceneProtocol) -> None:
    errors = []
    for index in range(SCENES):
        scene = simulate_scene(protocol, voices, [5, index])
        answer = localize(client, scene, num_sources=1)
        (source,) = answer["windows"][0]["sources"]
        gap = source["azimuth_deg"] - np.rad2deg(scene.azimuth[0])
        errors.append(abs((gap + 180) % 360 - 180))
    assert np.median(errors) < 3.0


def test_the_count_is_mostly_right(client, voices) -> None:
    right = 0
    for index in range(SCENES):
        count = index % 3
        protocol = SceneProtocol(num_sources=max(count, 1), min_separation_deg=40, orders=(0, 3))
        scene = simulate_scene(protocol, voices, [6, index])
        if count == 0:
            noise = np.random.default_rng(index).standard_normal(scene.audio.shape)
            scene = replace(scene, audio=noise.astype(np.float32), azimuth=scene.azimuth[:0])
        right += localize(client, scene)["windows"][0]["num_sources"] == count
    assert right >= 0.7 * SCENES
