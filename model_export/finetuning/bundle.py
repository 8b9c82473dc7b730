"""Export of a fine-tuned model to a bundle that records its origin and its recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from model_export.export.bundle import digest
from model_export.export.parameters import TrainedModel
from model_export.export.regression import export_regression
from model_export.export.weights import export_weights
from model_export.finetuning.labelled_recordings import LabelledRecording
from model_export.training.regression import RegressionTask
from model_export.training.task import STFT
from model_export.training.weights_task import WeightsTask
from service.doa.array import MicrophoneArray
from service.inference.manifest import Manifest


def export_finetuned(
    model: TrainedModel, start: Manifest, out: Path, name: str, record: Mapping[str, Any]
) -> Manifest:
    """Write the bundle; ``start`` is the manifest of the bundle that was fine-tuned."""
    parameters = start.training["parameters"]
    origin = {"name": start.name, "version": start.version, "parameters": parameters}
    earlier = start.training.get("fine_tuning")
    kept = {name: value for name, value in start.training.items() if name != "known"}
    training = {
        **kept,  # the networks for known numbers of talkers stay behind: they have learned nothing
        "parameters": digest(model.task.model.state_dict()),
        "fine_tuning": {"from": origin, **record, **({"earlier": earlier} if earlier else {})},
    }
    fields = {
        "name": name,
        "version": start.version,
        "description": f"{start.name} {start.version}, fine-tuned on {record['recordings']} "
        f"recordings of {record['array']['name']}.",
        "training": training,
        "scores": {},  # the old ones belong to other parameters
        "licences": list(dict.fromkeys([*start.licences, "the user's own recordings"])),
    }
    if isinstance(model.task, RegressionTask):
        return export_regression(model.task, out, fields)
    assert isinstance(model.task, WeightsTask)
    assert model.source_count is not None
    return export_weights(model.task.model, model.source_count, out, fields)


def fine_tuning_record(
    recordings: Sequence[LabelledRecording],
    array: MicrophoneArray,
    settings: Mapping[str, Any],
    *,
    simulated: bool,
) -> dict[str, Any]:
    """Record of recordings and settings for the manifest's ``training["fine_tuning"]``.

    ``simulated`` says whether simulated scenes were mixed in.
    """
    samples = sum(recording.audio.shape[1] for recording in recordings)
    return {
        "recordings": len(recordings),
        "seconds": round(samples / STFT.sample_rate, 1),
        "directions": len({recording.direction for recording in recordings}),
        "array": {"name": array.name, "positions_m": array.positions.tolist()},
        "simulated_scenes_too": simulated,
        "settings": dict(settings),
    }
