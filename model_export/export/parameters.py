"""The trained model inside a bundle, ``parameters.npz``, from which fine-tuning starts.

The ONNX graphs cannot be trained further, and users have no run folder. The file holds every
tensor of the trained networks, BatchNorm's statistics included, under its ``state_dict`` name with
the prefix ``model.`` or ``source_count.``; the training configuration in the manifest determines
the networks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from model_export.training.config import TrainingConfig
from model_export.training.counting import CandidateCountNetwork
from model_export.training.reparametrize import merge
from model_export.training.task import Task
from model_export.training.variants import task_of
from service.doa.types import FloatArray
from service.inference.bundle import PARAMETERS, Bundle, read_arrays


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """A bundle's networks with the text's parameters, in evaluation mode."""

    config: TrainingConfig
    task: Task[Any]
    source_count: CandidateCountNetwork | None
    """Source count of the `weights` variant; None for `regression`, whose model counts itself"""


def parameter_arrays(**networks: nn.Module) -> dict[str, FloatArray]:
    """Every tensor of the networks' states by ``<network>.<name in its state_dict>``."""
    return {
        f"{network}.{name}": tensor.detach().cpu().numpy()
        for network, module in networks.items()
        for name, tensor in module.state_dict().items()
    }


def trained_model(bundle: Bundle) -> TrainedModel:
    """Load the model that a bundle was exported from.

    Raises
    ------
    ValueError
        If the bundle holds no parameters, or they do not fit this version's networks.
    """
    manifest = bundle.manifest
    if PARAMETERS not in manifest.files:
        raise ValueError(
            f"the bundle {manifest.name} holds no {PARAMETERS} and cannot be fine-tuned: export "
            "its run again, or use a newer bundle"
        )
    path = bundle.folder / PARAMETERS
    arrays = read_arrays(path.read_bytes(), path)
    try:
        config = TrainingConfig.from_dict(manifest.training["config"])
        task = task_of(config)
        merge(task.model)
        _load(task.model, "model", arrays)
        source_count = None
        if config.variant == "weights":
            source_count = CandidateCountNetwork()
            _load(source_count, "source_count", arrays)
    except (KeyError, TypeError, RuntimeError) as error:  # RuntimeError: load_state_dict's
        raise ValueError(
            f"{PARAMETERS} of the bundle {manifest.name} does not fit the networks of this "
            f"version of model_export: {error}"
        ) from error
    return TrainedModel(config, task, source_count)


def source_count_of(folder: Path) -> CandidateCountNetwork:
    """Load the source-count network of a `weights` bundle.

    Raises
    ------
    ValueError
        If the folder holds no such network.
    """
    path = folder / PARAMETERS
    network = CandidateCountNetwork()
    try:
        _load(network, "source_count", read_arrays(path.read_bytes(), path))
    except (OSError, RuntimeError) as error:  # RuntimeError: load_state_dict's
        raise ValueError(f"{folder} holds no source count of a weights bundle: {error}") from error
    return network


def _load(module: nn.Module, network: str, arrays: Mapping[str, FloatArray]) -> None:
    prefix = f"{network}."
    state = {
        name.removeprefix(prefix): torch.tensor(array)
        for name, array in arrays.items()
        if name.startswith(prefix)
    }
    module.load_state_dict(state)
    module.eval()
