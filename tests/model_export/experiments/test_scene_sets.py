"""Scene sets: storage, unbiased parts, reproducible simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from model_export.experiments.augmentation import white_noise
from model_export.experiments.scene_set import Recipe, SceneSet, is_whole, simulated
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.scenes import WINDOW_SAMPLES
from model_export.simulation.synthesis import synthetic_voice
from service.doa.presets import preset

pytestmark = pytest.mark.torch

SQUARE = preset("respeaker-usb-4mic-v2")


@pytest.fixture(scope="module")
def voices() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [synthetic_voice(rng, 1.0) for _ in range(4)]


def test_a_set_reads_as_it_was_simulated(tmp_path: Path, voices) -> None:
    protocols = (SceneProtocol(), SceneProtocol(num_sources=2))
    recipe = Recipe("two kinds", protocols, "train", 4, 5)
    first = simulated(tmp_path / "set", recipe, voices, workers=1)
    again = SceneSet.read(tmp_path / "set")
    assert len(again) == 4
    assert [len(again.sources(index)) for index in range(4)] == [1, 2, 1, 2]
    np.testing.assert_array_equal(first.audio, again.audio)
    scene = simulate_scene(protocols[1], voices, [5, 1])
    kept = again.window(1)
    scaled = scene.audio / np.abs(scene.audio).max()
    error = np.sum((kept[:, : scaled.shape[1]] - scaled) ** 2) / np.sum(scaled**2)
    assert 10 * np.log10(error) < -60
    np.testing.assert_allclose(again.sources(1), scene.azimuth, rtol=1e-6)


def test_parts_favour_no_direction(tmp_path: Path) -> None:
    # Sorted by direction, like a listing of files: the first fifth would be one sector.
    azimuth = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    scenes = ((np.zeros((4, 8)), np.array([a])) for a in azimuth)
    part = SceneSet.write(tmp_path / "sorted", scenes, SQUARE).share(0.2)
    assert len(part) == 100
    counts, _ = np.histogram(part.azimuth[:, 0], bins=4, range=(0, 2 * np.pi))
    assert counts.min() >= 12  # 25 each on average, standard deviation 4
    assert part.audio.shape == (100, 4, WINDOW_SAMPLES)


def test_sparse_directions_are_the_only_ones(voices) -> None:
    protocol = SceneProtocol(num_sources=2, azimuths_deg=tuple(range(0, 360, 10)))
    for seed in range(5):
        azimuth = np.rad2deg(simulate_scene(protocol, voices, [seed]).azimuth)
        np.testing.assert_allclose(azimuth, 10 * np.round(azimuth / 10), atol=1e-9)


def test_white_noise_has_the_ratio_asked_for() -> None:
    rng = np.random.default_rng(0)
    clean = rng.standard_normal((4, 20000), dtype=np.float32) * 0.1
    noise = white_noise(rng, clean, 6.0) - clean
    assert 10 * np.log10(np.mean(clean**2) / np.mean(noise**2)) == pytest.approx(6.0, abs=0.2)


def test_too_many_sources_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at most 3"):
        SceneSet.write(tmp_path, [(np.zeros((4, 8)), np.arange(4.0))], SQUARE)


def test_an_interrupted_set_is_not_whole(tmp_path: Path) -> None:
    def scenes():
        yield np.zeros((4, 8)), np.zeros(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        SceneSet.write(tmp_path, scenes(), SQUARE)
    assert not is_whole(tmp_path)
    SceneSet.write(tmp_path, [(np.zeros((4, 8)), np.zeros(1))], SQUARE)
    assert is_whole(tmp_path)


def test_a_set_without_scenes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no scene has a known direction"):
        SceneSet.write(tmp_path, [], SQUARE)
