"""The trained model inside a bundle, ``parameters.npz``, from which fine-tuning starts.

The ONNX graphs cannot be trained further, and users have no run folder. The file holds every
tensor of the trained networks, BatchNorm's statistics included, under its ``state_dict`` name with
the prefix ``model.`` or ``source_count.``, and ``known_<count>.`` for the networks of one number of
talkers each, without their count branch; the training configurations in the manifest determine the
networks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from torch import nn

from model_export.export.bundle import digest
from model_export.training.config import TrainingConfig
from model_export.training.counting import CandidateCountNetwork
from model_export.training.regression import RegressionTask
from model_export.training.reparametrize import merge
from model_export.training.task import Task
from model_export.training.train import load_run
from model_export.training.variants import task_of
from service.doa.types import FloatArray
from service.inference.bundle import MANIFEST, PARAMETERS, Bundle, load_bundle, read_arrays

RECORD = ("config", "steps", "scenes", "parameters")
"""Names of a training's record in the manifest"""


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """A bundle's networks with the text's parameters, in evaluation mode."""

    config: TrainingConfig
    task: Task[Any]
    source_count: CandidateCountNetwork | None
    """Source count of the `weights` variant; None for `regression`, whose model counts itself"""


def parameter_arrays(
    known: Mapping[int, nn.Module] = MappingProxyType({}), /, **networks: nn.Module
) -> dict[str, FloatArray]:
    """Every tensor of the networks' states by ``<network>.<name in its state_dict>``."""
    arrays = {
        f"{network}.{name}": tensor.detach().cpu().numpy()
        for network, module in networks.items()
        for name, tensor in module.state_dict().items()
    }
    for count, module in known.items():
        own = parameter_arrays(**{_known(count): module})
        arrays |= {name: array for name, array in own.items() if not _counts(name)}
    return arrays


def _known(count: int | str) -> str:
    return f"known_{count}"


def _counts(name: str) -> bool:
    """Whether a tensor is of the count branch, which a network of one number has no use for."""
    return name.split(".")[1] == "count"


def trained_model(bundle: Bundle) -> TrainedModel:
    """Load the model that a bundle was exported from.

    Raises
    ------
    ValueError
        If the bundle holds no parameters, or they do not fit this version's networks.
    """
    with _arrays(bundle) as arrays:
        config = TrainingConfig.from_dict(bundle.manifest.training["config"])
        task = task_of(config)
        merge(task.model)
        _load(task.model, "model", arrays)
        source_count = None
        if config.variant == "weights":
            source_count = CandidateCountNetwork()
            _load(source_count, "source_count", arrays)
    return TrainedModel(config, task, source_count)


@dataclass(frozen=True, slots=True)
class TrainedTask:
    """A task whose training ended, and how much it took."""

    task: Task[Any]
    record: Mapping[str, Any]
    """The manifest's record: ``config``, ``steps``, ``scenes`` and the digest ``parameters``"""

    @classmethod
    def of_run(cls, run: Path) -> TrainedTask:
        """A run's last checkpoint; FileNotFoundError if there is none."""
        config, task, step = load_run(run)
        record = {
            "config": config.as_dict(),
            "steps": step,
            "scenes": config.scenes_in(step),
            "parameters": digest(task.model.state_dict()),
        }
        return cls(task, record)

    @classmethod
    def of_bundle(cls, bundle: Bundle) -> TrainedTask:
        """A bundle's network for any number of talkers; ValueError as in ``trained_model``."""
        record = {name: bundle.manifest.training[name] for name in RECORD}
        return cls(trained_model(bundle).task, record)


def trained_task(folder: Path, known_count: int | None = None) -> TrainedTask:
    """Load the network of a run's or a bundle's folder.

    A bundle that has a network of its own for ``known_count`` talkers gives that one.

    Raises
    ------
    FileNotFoundError
        If the folder holds neither.
    ValueError
        If it is a bundle without parameters, or with those of other networks.
    """
    if not (folder / MANIFEST).exists():
        return TrainedTask.of_run(folder)
    bundle = load_bundle(folder)
    return known_networks(bundle).get(known_count or 0) or TrainedTask.of_bundle(bundle)


def known_networks(bundle: Bundle) -> dict[int, TrainedTask]:
    """Load a bundle's networks for one number of talkers each, by that number.

    Their count branches are fresh ones.

    Raises
    ------
    ValueError
        If the bundle holds no parameters, or they do not fit this version's networks.
    """
    known: dict[str, Mapping[str, Any]] = bundle.manifest.training.get("known", {})
    if not known:
        return {}
    networks: dict[int, TrainedTask] = {}
    with _arrays(bundle) as arrays:
        for number, record in known.items():
            task = RegressionTask(TrainingConfig.from_dict(record["config"]))
            merge(task.model)
            fresh = parameter_arrays(**{_known(number): task.model})
            counting = {name: array for name, array in fresh.items() if _counts(name)}
            _load(task.model, _known(number), {**arrays, **counting})
            networks[int(number)] = TrainedTask(task, record)
    return networks


@contextmanager
def _arrays(bundle: Bundle) -> Iterator[Mapping[str, FloatArray]]:
    """The bundle's tensors; what does not fit the networks is said so."""
    manifest = bundle.manifest
    if PARAMETERS not in manifest.files:
        raise ValueError(
            f"the bundle {manifest.name} holds no {PARAMETERS} and cannot be trained further: "
            "export its run again, or use a newer bundle"
        )
    path = bundle.folder / PARAMETERS
    arrays = read_arrays(path.read_bytes(), path)
    try:
        yield arrays
    except (KeyError, TypeError, RuntimeError) as error:  # RuntimeError: load_state_dict's
        raise ValueError(
            f"{PARAMETERS} of the bundle {manifest.name} does not fit the networks of this "
            f"version of model_export: {error}"
        ) from error


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
