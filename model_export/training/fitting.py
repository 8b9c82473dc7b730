"""A model that is being fitted: optimizer, schedule and checkpoint, the same for every training."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

CHECKPOINT = "checkpoint.pt"
"""File of a run's folder"""


class Fitting:
    """One run's optimization, resumed from the folder's checkpoint if there is one.

    Parameters
    ----------
    model : Module
        The model, on the device of the training.
    optimizer : Optimizer
        Optimizer of its parameters with the first learning rate, which falls to a hundredth along a
        cosine.
    steps, warm_up : int
        Steps of the whole run, and of the linear warm-up.
    run : Path
        Existing folder of the run.
    """

    def __init__(
        self,
        model: nn.Module,
        optimizer: torch.optim.Optimizer,
        steps: int,
        warm_up: int,
        run: Path,
    ) -> None:
        self.step = 0
        self._model, self._optimizer, self._run = model, optimizer, run
        self._schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, _cosine(steps, warm_up))
        if (run / CHECKPOINT).exists():
            state = checkpoint(run)
            model.load_state_dict(state["model"])
            optimizer.load_state_dict(state["optimizer"])
            self._schedule.load_state_dict(state["schedule"])
            self.step = int(state["step"])

    @property
    def learning_rate(self) -> float:
        """Learning rate of the next step."""
        return float(self._schedule.get_last_lr()[0])

    def optimize(self, loss: Tensor) -> None:
        """Take one step down the loss's gradient, clipped to a norm of 1."""
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._model.parameters(), 1.0)
        self._optimizer.step()
        self._schedule.step()
        self.step += 1

    def save(self) -> None:
        """Write the checkpoint; an interrupted write leaves the previous one."""
        unfinished = self._run / "checkpoint.part"
        state = {
            "step": self.step,
            "model": self._model.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "schedule": self._schedule.state_dict(),
        }
        torch.save(state, unfinished)
        unfinished.rename(self._run / CHECKPOINT)


def checkpoint(run: Path) -> dict[str, Any]:
    """All that a run left when it was last interrupted or ended, on the CPU."""
    state: dict[str, Any] = torch.load(run / CHECKPOINT, weights_only=True, map_location="cpu")
    return state


def _cosine(steps: int, warm_up: int) -> Callable[[int], float]:
    def factor(step: int) -> float:
        beginning = min(1.0, (step + 1) / warm_up)
        return beginning * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, step / steps))))

    return factor
