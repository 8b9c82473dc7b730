"""Runs: interrupted ones continue where they stopped, finished ones train nothing."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import ANY_ARRAY, PAPER_KNOWN, TrainingConfig
from model_export.training.fitting import checkpoint
from model_export.training.regression import RegressionPipeline
from model_export.training.scene_stream import SceneStream
from model_export.training.train import WARM_UP, load_run, train
from model_export.training.weights_task import WeightsTask
from service.doa.presets import preset

pytestmark = pytest.mark.torch

CONFIG = replace(ANY_ARRAY, steps=6, batch_size=2, grid_size=36, checkpoint_every=2)
POSITIONS = preset("respeaker-usb-4mic-v2").positions


class Interrupted(Exception):
    pass


@dataclass
class Noise:
    """Scenes of noise with random directions as labels; the supply may break off."""

    batches: int | None = None

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        given = 0
        while self.batches is None or given < self.batches * config.batch_size:
            audio = rng.standard_normal((4, WINDOW_SAMPLES), dtype=np.float32)
            yield Scene(audio, POSITIONS, rng.uniform(0, 2 * np.pi, 1))
            given += 1
        raise Interrupted


def curve(run: Path) -> list[dict[str, str]]:
    with (run / "curves.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def continued(run: Path) -> tuple[WeightsTask, list[float]]:
    """The rest of an interrupted run, optimized by hand: its task and the losses of its steps."""
    state = checkpoint(run)
    task = WeightsTask(CONFIG)
    task.model.load_state_dict(state["model"])
    optimizer = torch.optim.AdamW(task.model.parameters(), weight_decay=CONFIG.weight_decay)
    optimizer.load_state_dict(state["optimizer"])
    stream = SceneStream(CONFIG, Noise(), first_step=state["step"])
    losses = []
    task.model.train()
    for step, batch in zip(range(state["step"], CONFIG.steps), stream, strict=False):
        cosine = 0.01 + 0.99 * (1 + math.cos(math.pi * step / CONFIG.steps)) / 2
        for group in optimizer.param_groups:
            group["lr"] = CONFIG.learning_rate * cosine * (step + 1) / WARM_UP
        optimizer.zero_grad()
        loss = task.losses(batch)["loss"]
        loss.backward()
        torch.nn.utils.clip_grad_norm_(task.model.parameters(), 1.0)
        optimizer.step()
        losses.append(float(loss.detach()))
    return task, losses


def test_a_run_that_is_interrupted_goes_on_at_its_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(Interrupted):
        train(CONFIG, tmp_path, Noise(batches=3), Noise())
    assert checkpoint(tmp_path)["step"] == 2  # the third step is lost
    assert [row["step"] for row in curve(tmp_path)] == ["2"]
    expected, losses = continued(tmp_path)

    trained = train(CONFIG, tmp_path, Noise(batches=4), Noise())
    state = checkpoint(tmp_path)
    assert state["step"] == 6
    assert [row["step"] for row in curve(tmp_path)] == ["2", "4", "6"]
    running = [losses[0]]
    for loss in losses[1:]:
        running.append(0.98 * running[-1] + 0.02 * loss)
    logged = [float(row["loss"]) for row in curve(tmp_path)[1:]]
    assert logged == pytest.approx([running[1], running[3]], rel=1e-3)
    moments = state["optimizer"]["state"].values()
    assert {int(moment["step"]) for moment in moments} == {6}  # not those of four steps
    for name, parameter in expected.model.state_dict().items():
        torch.testing.assert_close(trained.model.state_dict()[name], parameter, msg=name)


def test_a_run_that_is_trained_otherwise_goes_on_and_leaves_the_text_s_network(
    tmp_path: Path,
) -> None:
    config = replace(
        PAPER_KNOWN[0], starts_from=None, steps=4, batch_size=2, checkpoint_every=2,
        validation_scenes=2,
    )  # fmt: skip
    with pytest.raises(Interrupted):
        train(config, tmp_path, Noise(batches=3), Noise(), workers=0)
    kept = checkpoint(tmp_path)
    assert kept["step"] == 2
    free = kept["model"]["covariance.encoder.3.0.parametrizations.weight.original"]
    assert len(free) == config.smooth_kernels  # goes on as it was trained
    trained = train(config, tmp_path, Noise(), Noise(), workers=0)
    assert [row["step"] for row in curve(tmp_path)] == ["2", "4"]
    _, loaded, step = load_run(tmp_path)
    plain = RegressionPipeline(4).state_dict()
    assert step == 4
    for task in (trained, loaded):
        state = task.model.state_dict()
        assert {name: value.shape for name, value in state.items()} == {
            name: value.shape for name, value in plain.items()
        }
    for name, value in trained.model.state_dict().items():
        torch.testing.assert_close(loaded.model.state_dict()[name], value, msg=name)


def test_a_finished_run_trains_nothing_and_other_settings_are_refused(tmp_path: Path) -> None:
    short = replace(CONFIG, steps=1)
    train(short, tmp_path, Noise(), Noise())
    before = curve(tmp_path)
    train(short, tmp_path, Noise(batches=0), Noise(batches=0))  # no scene is asked for
    assert curve(tmp_path) == before
    with pytest.raises(ValueError, match="holds a run with other settings"):
        train(replace(short, seed=2), tmp_path, Noise(), Noise())


def test_another_seed_makes_other_batches_and_another_step_too() -> None:
    def first(config: TrainingConfig, step: int) -> torch.Tensor:
        (batch,) = islice(SceneStream(config, Noise(), first_step=step), 1)
        return batch.features

    assert torch.equal(first(CONFIG, 2), first(CONFIG, 2))
    assert not torch.equal(first(CONFIG, 2), first(CONFIG, 0))
    assert not torch.equal(first(CONFIG, 2), first(replace(CONFIG, seed=2), 2))


def test_the_last_tenth_of_the_steps_takes_larger_batches() -> None:
    config = replace(CONFIG, steps=20, final_batch_size=5)
    sizes = [len(batch.features) for batch in islice(SceneStream(config, Noise()), 20)]
    assert sizes == [2] * 18 + [5] * 2
    resumed = SceneStream(config, Noise(), first_step=17)
    assert [len(batch.features) for batch in islice(resumed, 2)] == [2, 5]
    assert [config.scenes_in(steps) for steps in (0, 18, 20)] == [0, 36, sum(sizes)]
    # Two processes take turns, whichever step comes first.
    loader = DataLoader(SceneStream(config, Noise(), first_step=16), batch_size=None, num_workers=2)
    assert [len(batch.features) for batch in islice(loader, 4)] == sizes[16:]


def test_a_run_of_a_version_with_fewer_settings_goes_on(tmp_path: Path) -> None:
    short = replace(CONFIG, steps=1, validation_scenes=2)
    train(short, tmp_path, Noise(), Noise(), workers=0)
    path = tmp_path / "config.json"
    settings = json.loads(path.read_text())
    del settings["attention"], settings["final_batch_size"]
    path.write_text(json.dumps(settings))
    train(short, tmp_path, Noise(batches=0), Noise(batches=0))
    with pytest.raises(ValueError, match="holds a run with other settings"):
        train(replace(short, final_batch_size=8), tmp_path, Noise(), Noise())
