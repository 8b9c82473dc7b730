"""The variants: the task of a configuration, and the batches that it learns from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from model_export.simulation.scenes import Scene
from model_export.training.config import TrainingConfig, Variant
from model_export.training.distil import DistilTask
from model_export.training.regression import RegressionTask, collate_regression
from model_export.training.sscl import SsclTask, collate_masked
from model_export.training.task import Batch, Task
from model_export.training.weights_task import WeightsTask, collate_cells, collate_weights

TASKS: dict[Variant, Callable[[TrainingConfig], Task[Any]]] = {
    "weights": WeightsTask,
    "regression": RegressionTask,
    "sscl": SsclTask,
}


def task_of(config: TrainingConfig) -> Task[Any]:
    """The task of a configuration, with a freshly initialised model."""
    return DistilTask(config) if config.distils else TASKS[config.variant](config)


def collate(config: TrainingConfig, rng: np.random.Generator, scenes: Sequence[Scene]) -> Batch:
    """Make the batch for the configuration's task, without building a network."""
    if config.distils:
        return collate_cells(config, rng, scenes)
    if config.variant == "weights":
        return collate_weights(config, rng, scenes)
    if config.variant == "regression":
        return collate_regression(config, rng, scenes)
    return collate_masked(rng, scenes, config.level_exponent)
