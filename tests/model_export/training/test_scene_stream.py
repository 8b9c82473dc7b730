"""Scenes become batches with the truth of every cell, and without any network."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.simulation.synthesis import synthetic_voice
from model_export.training.config import (
    ANY_ARRAY,
    ANY_ARRAY_LIGHT,
    PAPER,
    PAPER_SSCL,
    TrainingConfig,
)
from model_export.training.scene_stream import ProtocolScenes, SceneStream
from model_export.training.task import SHORT_SAMPLES, STFT
from model_export.training.weights_task import WeightsBatch, direct_share
from service.doa.presets import preset
from service.doa.steering import steering_vectors

pytestmark = pytest.mark.torch

ARRAY = preset("respeaker-usb-4mic-v2")
SAMPLES = WINDOW_SAMPLES


class Silence:
    """Scenes of faint noise with a talker at 1 rad, whose direct sound is unknown."""

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        while True:
            audio = rng.standard_normal((4, WINDOW_SAMPLES)).astype(np.float32)
            yield Scene(audio, ARRAY.positions, np.ones(1))


def test_development_scenes_are_the_same_for_every_seed_and_have_the_counts_asked_for() -> None:
    voices = [synthetic_voice(np.random.default_rng(0), 1.0)]
    source = ProtocolScenes("respeaker-usb-4mic-v2", voices)
    config = replace(PAPER, scenes=replace(PAPER.scenes, source_counts=(0.3, 0.4, 0.3)))
    first, again = (
        list(islice(source.scenes(np.random.default_rng(seed), config), 8)) for seed in (1, 2)
    )
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.audio, other.audio)
        assert one.audio.shape == (4, WINDOW_SAMPLES)
    assert {len(scene.azimuth) for scene in first} == {0, 1, 2}


def refuse(*_: object) -> None:
    raise AssertionError("a network was built")


@pytest.mark.parametrize("config", [ANY_ARRAY, ANY_ARRAY_LIGHT, PAPER, PAPER_SSCL])
def test_batches_come_without_a_network(
    config: TrainingConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.nn.Module, "__init__", refuse)
    stream = SceneStream(replace(config, batch_size=2), Silence())
    first, again = next(iter(stream)), next(iter(stream))
    assert torch.equal(first.features, again.features)
    assert first.features.shape[0] == 2
    assert first.to("meta").features.is_meta
    assert type(first.to("meta")) is type(first)


def test_grids_and_bins_shift_and_some_batches_are_short() -> None:
    config = replace(ANY_ARRAY, batch_size=1, grid_size=36, short_windows=0.5)
    batches = list(islice(SceneStream(config, Silence()), 12))
    assert all(isinstance(batch, WeightsBatch) for batch in batches)
    frames = {batch.features.shape[-1] for batch in batches}
    assert frames == {STFT.num_frames(SHORT_SAMPLES), STFT.num_frames(WINDOW_SAMPLES)}
    for batch in batches:
        assert torch.rad2deg(batch.grid.diff()) == pytest.approx(10, abs=1e-3)
        assert 0 <= batch.grid[0] < np.deg2rad(10)
        assert (batch.bins.diff() == 2).all()
        assert batch.spectra.shape[2] == len(batch.bins)
        assert batch.mask.tolist() == [[True, False, False, False]]
    assert len({float(batch.grid[0]) for batch in batches}) == 12
    assert {int(batch.bins[0]) for batch in batches} == {0, 1}


def test_steering_delays_are_those_of_the_array() -> None:
    batch = next(iter(SceneStream(replace(ANY_ARRAY, batch_size=1, grid_size=36), Silence())))
    steering = steering_vectors(ARRAY.positions, np.array([1000.0]), batch.grid.double().numpy())
    phases = np.exp(2j * np.pi * 1000 * batch.delays[0].numpy())
    np.testing.assert_allclose(phases, steering[0], atol=1e-4)


def test_the_direct_share_is_one_where_only_the_talker_sounds_and_zero_where_only_noise() -> None:
    rng = np.random.default_rng(3)
    talker = rng.standard_normal((1, SAMPLES)).astype(np.float32)
    talker[:, SAMPLES // 2 :] = 0
    noise = rng.standard_normal(SAMPLES).astype(np.float32)
    noise[: SAMPLES // 2] = 0
    scene = Scene(talker, np.zeros((1, 3)), np.array([0.0]), talker, talker[0] + noise)
    shares = direct_share(scene)
    assert shares[:, :30].min() > 0.999
    assert shares[:, 34:].max() < 1e-3
    silent = Scene(talker, np.zeros((1, 3)), np.zeros(0), talker[:0], noise)
    assert not direct_share(silent).any()
