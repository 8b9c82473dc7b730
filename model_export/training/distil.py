"""Distillation: a lighter network learns a trained network's weights and attentions.

No spectra are computed, so a step costs the convolutions alone, and every cell of every scene is a
target. The spectra, for which the teacher was trained, are left to a short stage afterwards.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from model_export.training.precision import training_precision
from model_export.training.task import Task
from model_export.training.weights import WeightsNetwork
from model_export.training.weights_task import CellBatch, WeightsTask, known_cross_entropy

LEAST_IMPORTANCE = 0.2
"""Weight of a cell that the teacher ignores, since it may matter; mean attention adds 1"""
SCALE_WEIGHT = 0.1
"""Weight of the sum of the attentions, which only the source count uses"""
SHARE_WEIGHT = 0.2
"""Weight of the share of direct sound, which ties the hidden layers to the truth"""


class DistilTask(WeightsTask):
    """The `weights` variant, taught by the run that the configuration starts from."""

    _teacher: WeightsNetwork | None = None

    def start_from(self, start: Task[Any]) -> None:
        """Learn from ``start``, and copy its parameters behind the convolutions that look ahead."""
        assert isinstance(start, WeightsTask)
        taught, teaching = self.model.network, start.model.network
        self.model.load_state_dict(
            {
                name: tensor
                for name, tensor in start.model.state_dict().items()
                if not name.startswith("network.blocks")
            },
            strict=False,
        )
        behind = slice(taught.lookahead, None), slice(teaching.lookahead, None)
        taught.blocks[behind[0]].load_state_dict(teaching.blocks[behind[1]].state_dict())
        self._teacher = start.model.network.eval().requires_grad_(False)

    def losses(self, batch: CellBatch) -> dict[str, Tensor]:
        assert self._teacher is not None
        network = self.model.network
        features = batch.features.transpose(2, 3).contiguous(memory_format=torch.channels_last)
        with training_precision(features, training=self.model.training):
            hidden = network.hidden(features)
            weights, attention = network.cells(hidden)
            share = network.direct_share(hidden)
        with torch.no_grad():
            taught_weights, taught_attention = self._teacher(features)
        total, taught_total = (_total(each.float()) for each in (attention, taught_attention))
        taught_share = taught_attention / taught_total
        importance = LEAST_IMPORTANCE + taught_share * taught_share[0].numel()
        weight_loss = F.binary_cross_entropy(
            weights.float().clamp(1e-6, 1 - 1e-6), taught_weights, importance
        ) - F.binary_cross_entropy(taught_weights.clamp(1e-6, 1 - 1e-6), taught_weights, importance)
        divergence = (
            taught_share * ((taught_share + 1e-12) / (attention.float() / total + 1e-12)).log()
        )
        losses = {
            "weights": weight_loss,
            "attention": divergence.sum((1, 2)).mean(),
            "scale": (total / taught_total).log().square().mean(),
            "share": known_cross_entropy(share.float(), batch.direct_share.transpose(1, 2)),
        }
        loss = losses["weights"] + losses["attention"] + SCALE_WEIGHT * losses["scale"]
        return {"loss": loss + SHARE_WEIGHT * losses["share"], **losses}

    def scores(self, batch: CellBatch) -> dict[str, Tensor]:
        losses = self.losses(batch)
        return {f"held_{name}": losses[name][None] for name in ("weights", "attention")}


def _total(cells: Tensor) -> Tensor:
    """Sum (B, 1, 1) over the cells of every window, at least the smallest float32."""
    return cells.sum((1, 2), True).clamp(min=torch.finfo(torch.float32).tiny)
