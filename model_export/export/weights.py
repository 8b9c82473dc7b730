"""Export of the `weights` variant: its networks, the source-count network and the parity check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from model_export.export.bundle import (
    ExportGraph,
    export_onnx,
    golden_windows,
    stft_section,
    write_bundle,
)
from model_export.export.parameters import parameter_arrays
from model_export.export.stream_graph import stream_graph
from model_export.training.counting import CandidateCountNetwork
from model_export.training.subspace import delay_products
from model_export.training.task import STFT, steering_delays
from model_export.training.weights import KEPT_SHARE, WINDOW_SHARE, WeightsPipeline
from service.doa.array import MicrophoneArray
from service.doa.features import NUM_FEATURES, coherence_features, unit_vectors_and_power
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, resolution
from service.doa.types import FloatArray
from service.inference.candidates import NUM_CANDIDATES
from service.inference.descriptors import NUM_DESCRIPTORS
from service.inference.engine import Engine
from service.inference.manifest import Manifest
from service.inference.results import MAX_SOURCES
from service.inference.weights import Analysis, CandidateSearch

FIRST_BIN = 1
FRAMES = 64
GRID_SIZE = 180
PARITY_WINDOWS = 4


def export_weights(
    pipeline: WeightsPipeline,
    source_count: CandidateCountNetwork,
    folder: Path,
    fields: Mapping[str, Any],
) -> Manifest:
    """Write a `weights` bundle; ``fields`` name and describe it (see ``Manifest``)."""
    pipeline.eval()
    array = preset("respeaker-usb-4mic-v2")
    windows = golden_windows(array, PARITY_WINDOWS)
    analysis = analysis_of(pipeline)
    return write_bundle(
        folder,
        {
            **fields,
            "variant": "weights",
            "array": "any",
            "stft": stft_section(FRAMES),
            "grid_size": GRID_SIZE,
            "first_bin": FIRST_BIN,
            "num_bins": analysis.num_bins,
            "max_sources": MAX_SOURCES,
        },
        {
            "covariance": covariance_graph(pipeline),
            "source_count": count_graph(source_count),
            "covariance_stream": stream_graph(pipeline.network, analysis.num_bins),
        },
        {
            "floor": np.array(analysis.floor, np.float32),
            "dominance_power": np.array(analysis.dominance_power, np.float32),
            "window_share": np.array(analysis.window_share, np.float32),
            "kept_share": np.array(analysis.kept_share, np.float32),
        },
        parameter_arrays(model=pipeline, source_count=source_count),
        {1: reference_spectra(pipeline, windows, array)},
        windows,
        array,
    )


def covariance_graph(pipeline: WeightsPipeline) -> ExportGraph:
    """Graph from features to weights and attentions, for any number of windows and frames."""
    return ExportGraph(
        pipeline.network,
        (torch.zeros(2, NUM_FEATURES, FRAMES, STFT.num_bins - FIRST_BIN),),
        ("features",),
        ("weights", "attention"),
        ({0: "batch", 2: "frames"},),
    )


def count_graph(network: CandidateCountNetwork) -> ExportGraph:
    """Graph from candidates' descriptors to logits of counts and confidences."""
    return ExportGraph(
        network,
        (torch.zeros(2, NUM_CANDIDATES, NUM_DESCRIPTORS),),
        ("descriptors",),
        ("count_logits", "confidence_logits"),
        ({0: "batch"},),
    )


def analysis_of(pipeline: WeightsPipeline) -> Analysis:
    """The search's parameters, from the trained pipeline."""
    return Analysis(
        stft=STFT,
        first_bin=FIRST_BIN,
        num_bins=STFT.num_bins - FIRST_BIN,
        grid_size=GRID_SIZE,
        floor=float(pipeline.log_floor.detach().exp()),
        dominance_power=float(pipeline.log_dominance_power.detach().exp()),
        window_share=WINDOW_SHARE,
        kept_share=KEPT_SHARE,
    )


def candidate_search(
    pipeline: WeightsPipeline, folder: Path
) -> Callable[[MicrophoneArray], CandidateSearch]:
    """The service's candidate search, for a pipeline without a source count and bundle."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "covariance.onnx"
    export_onnx(covariance_graph(pipeline), path)
    engine = Engine(path.read_bytes(), path.name)
    analysis = analysis_of(pipeline)
    return lambda array: CandidateSearch(engine, analysis, array)


@torch.no_grad()
def reference_spectra(
    pipeline: WeightsPipeline, windows: FloatArray, array: MicrophoneArray
) -> FloatArray:
    """The torch pipeline's fused spectra (B, A) of windows (B, N, T)."""
    pipeline.eval()
    spectra = STFT.transform(windows)[:, :, FIRST_BIN:]
    delays = steering_delays(array.positions[None], azimuth_grid(GRID_SIZE))
    frequencies = torch.from_numpy(STFT.frequencies[FIRST_BIN:]).float()
    products = delay_products(torch.from_numpy(delays), frequencies)
    resolved = resolution(array.positions, STFT.frequencies[FIRST_BIN:])
    result = pipeline(
        torch.from_numpy(coherence_features(*unit_vectors_and_power(spectra))),
        torch.from_numpy(spectra),
        products.expand(len(windows), -1, -1, -1),
        resolution=torch.full((len(windows),), resolved),
    )
    fused: FloatArray = result.fused.numpy()
    return fused
