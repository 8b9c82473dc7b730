"""Distillation: a lighter network learns its teacher's outputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from model_export.training.config import ANY_ARRAY_LIGHT, ANY_ARRAY_NOISE
from model_export.training.distil import DistilTask
from model_export.training.variants import task_of
from model_export.training.weights_task import CellBatch, WeightsTask
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

BINS, FRAMES = 256, 16


def cells(seed: int) -> FloatArray:
    """Features of quiet cells with a loud band that comes and goes."""
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((2, 5, BINS, FRAMES)).astype(np.float32)
    features[:, 2:] = np.abs(features[:, 2:]).clip(0, 1)
    features[:, 0, 40:90, 4:12] += 3
    return features


@pytest.fixture(scope="module")
def batch() -> CellBatch:
    return CellBatch(torch.from_numpy(cells(0)), torch.full((2, BINS, FRAMES), torch.nan))


def taught() -> tuple[WeightsTask, DistilTask]:
    torch.manual_seed(0)
    teacher = task_of(ANY_ARRAY_NOISE)
    assert isinstance(teacher, WeightsTask)
    teacher.model.eval()
    task = task_of(replace(ANY_ARRAY_LIGHT, steps=1))
    assert isinstance(task, DistilTask)
    task.start_from(teacher)
    return teacher, task


@pytest.mark.learns
def test_a_few_steps_bring_it_to_its_teacher(batch: CellBatch) -> None:
    _, task = taught()
    optimizer = torch.optim.AdamW(task.model.parameters(), lr=3e-3)
    task.model.train()
    first = task.losses(batch)
    for _ in range(40):
        losses = task.losses(batch)
        optimizer.zero_grad()
        losses["loss"].backward()
        optimizer.step()
    assert losses["attention"].detach() < 0.3 * first["attention"].detach()
    assert losses["weights"].detach() < 0.5 * first["weights"].detach()


def test_its_teacher_does_not_learn_and_is_not_saved(batch: CellBatch) -> None:
    teacher, task = taught()
    before = {name: tensor.clone() for name, tensor in teacher.model.state_dict().items()}
    task.model.train()
    task.losses(batch)["loss"].backward()
    assert all(parameter.grad is None for parameter in teacher.model.parameters())
    for name, tensor in teacher.model.state_dict().items():
        torch.testing.assert_close(tensor, before[name])
    # The layers behind the trunk start as the teacher's; the trunk is its own.
    state = task.model.state_dict()
    torch.testing.assert_close(state["network.head.weight"], before["network.head.weight"])
    assert state["network.blocks.0.0.weight"].shape != before["network.blocks.0.0.weight"].shape
    torch.testing.assert_close(
        state["network.blocks.5.first.weight"], before["network.blocks.5.first.weight"]
    )


def test_nothing_is_lost_where_it_says_the_same(batch: CellBatch) -> None:
    """A student that is its own teacher has no divergence: the losses are zero at their minimum."""
    _, task = taught()
    task.model.eval()
    task._teacher = task.model.network
    losses = task.losses(batch)
    for name in ("weights", "attention", "scale"):
        assert float(losses[name].detach()) == pytest.approx(0, abs=1e-4)
