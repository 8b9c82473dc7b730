"""Export of the `regression` variant: the paper's networks, bound to one array."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from torch import nn

from model_export.export.bundle import ExportGraph, golden_windows, stft_section, write_bundle
from model_export.export.parameters import parameter_arrays
from model_export.training.networks import NUM_BINS, NUM_FRAMES
from model_export.training.regression import RegressionPipeline, RegressionTask
from model_export.training.subspace import delay_products
from model_export.training.task import STFT, steering_delays
from service.doa.array import MicrophoneArray
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid
from service.doa.types import FloatArray
from service.inference.manifest import Manifest
from service.inference.results import MAX_SOURCES

GRID_SIZE = 360
PARITY_WINDOWS = 4


def export_regression(
    task: RegressionTask,
    folder: Path,
    fields: Mapping[str, Any],
    known: Mapping[int, RegressionTask] = MappingProxyType({}),
) -> Manifest:
    """Write a `regression` bundle.

    Parameters
    ----------
    task : RegressionTask
        Networks for any number of sources, and their count.
    folder : Path
    fields : mapping
        The manifest's descriptive fields (see ``Manifest``).
    known : mapping of int to RegressionTask, optional
        Networks for one number of sources each, of the same array and features.
    """
    if task.config.phase_reference != "first":
        raise ValueError("the service computes features with phase_reference 'first' only")
    pipeline, array = task.model, task.array
    windows = golden_windows(array, PARITY_WINDOWS)
    pipelines = {count: each.model for count, each in known.items()}
    answering = {0: pipeline, 1: pipeline, **pipelines}
    return write_bundle(
        folder,
        {
            **fields,
            "variant": "regression",
            "array": {"name": array.name, "positions_m": array.positions.tolist()},
            "stft": stft_section(NUM_FRAMES),
            "grid_size": GRID_SIZE,
            "first_bin": 0,
            "num_bins": NUM_BINS,
            "level_exponent": task.config.level_exponent,
            "max_sources": MAX_SOURCES,
        },
        {
            "covariance": _graph(pipeline.covariance, array, "covariance"),
            "source_count": _graph(pipeline.count, array, "count_logits"),
        },
        _fusion({"": pipeline, **{f"_{count}": each for count, each in pipelines.items()}}),
        parameter_arrays(pipelines, model=pipeline),
        {
            count: reference_spectra(each, windows, array, task.config.level_exponent, count)
            for count, each in answering.items()
        },
        windows,
        array,
        {n: _graph(each.covariance, array, "covariance") for n, each in pipelines.items()},
    )


def _graph(network: nn.Module, array: MicrophoneArray, output: str) -> ExportGraph:
    """Graph from features to one output."""
    example = torch.zeros(2, 2 * array.num_microphones, NUM_BINS, NUM_FRAMES)
    return ExportGraph(network, (example,), ("features",), (output,), ({0: "batch"},))


@torch.no_grad()
def _fusion(pipelines: Mapping[str, RegressionPipeline]) -> dict[str, FloatArray]:
    """Arrays of the bundle's file of the fusion, of pipelines by the ending of their names."""
    arrays: dict[str, FloatArray] = {}
    for ending, pipeline in pipelines.items():
        arrays[f"floor{ending}"] = pipeline.log_floor.exp().numpy()
        arrays[f"squeeze{ending}"] = pipeline.fusion.squeeze.weight.numpy()
        arrays[f"excite{ending}"] = pipeline.fusion.excite.weight.numpy()
    return arrays


@torch.no_grad()
def reference_spectra(
    pipeline: RegressionPipeline,
    windows: FloatArray,
    array: MicrophoneArray,
    level_exponent: float = 0.0,
    num_sources: int = 1,
) -> FloatArray:
    """The torch pipeline's fused spectra (B, A) of windows (B, N, T), so many sources asked for."""
    pipeline.eval()
    delays = steering_delays(array.positions[None], azimuth_grid(GRID_SIZE))
    frequencies = torch.from_numpy(STFT.frequencies).float()
    products = delay_products(torch.from_numpy(delays), frequencies)[0]
    features = spectrogram_features(STFT.transform(windows), level_exponent=level_exponent)
    counts = torch.full((len(windows),), num_sources)
    fused: FloatArray = pipeline(torch.from_numpy(features), products, counts).fused.numpy()
    return np.asarray(fused)
