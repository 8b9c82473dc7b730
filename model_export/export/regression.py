"""Export of the `regression` variant: the paper's networks, bound to one array."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

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


def export_regression(task: RegressionTask, folder: Path, fields: Mapping[str, Any]) -> Manifest:
    """Write a `regression` bundle; ``fields`` name and describe it (see ``Manifest``)."""
    if task.config.phase_reference != "first":
        raise ValueError("the service computes features with phase_reference 'first' only")
    pipeline, array = task.model, task.array
    pipeline.eval()
    windows = golden_windows(array, PARITY_WINDOWS)
    example = torch.zeros(2, 2 * array.num_microphones, NUM_BINS, NUM_FRAMES)
    batch = {0: "batch"}
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
            "covariance": ExportGraph(
                pipeline.covariance, (example,), ("features",), ("covariance",), (batch,)
            ),
            "source_count": ExportGraph(
                pipeline.count, (example,), ("features",), ("count_logits",), (batch,)
            ),
        },
        {
            "floor": pipeline.log_floor.detach().exp().numpy(),
            "squeeze": pipeline.fusion.squeeze.weight.detach().numpy(),
            "excite": pipeline.fusion.excite.weight.detach().numpy(),
        },
        parameter_arrays(model=pipeline),
        list(reference_spectra(pipeline, windows, array, task.config.level_exponent)),
        windows,
        array,
    )


@torch.no_grad()
def reference_spectra(
    pipeline: RegressionPipeline,
    windows: FloatArray,
    array: MicrophoneArray,
    level_exponent: float = 0.0,
) -> FloatArray:
    """The torch pipeline's fused spectra (B, A) of windows (B, N, T) with one source each."""
    delays = steering_delays(array.positions[None], azimuth_grid(GRID_SIZE))
    frequencies = torch.from_numpy(STFT.frequencies).float()
    products = delay_products(torch.from_numpy(delays), frequencies)[0]
    features = spectrogram_features(STFT.transform(windows), level_exponent=level_exponent)
    ones = torch.ones(len(windows), dtype=torch.long)
    fused: FloatArray = pipeline(torch.from_numpy(features), products, ones).fused.numpy()
    return np.asarray(fused)
