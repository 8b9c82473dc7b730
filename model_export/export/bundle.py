"""Export of trained networks to a bundle: ONNX graphs, fusion, golden self-test, parity.

Inputs and outputs of the graphs are real tensors with a dynamic batch axis; all complex arithmetic
is numpy's. Parity is the largest difference of the fused spectra of the same audio between the
torch pipeline and the service's localizer (onnxruntime and numpy); a bundle that exceeds the bound
is not written.
"""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import onnx
import torch
from torch import nn

from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.rooms import RoomSpec
from model_export.simulation.synthesis import synthetic_voice
from model_export.training.task import STFT
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import (
    CARD,
    COVARIANCE,
    COVARIANCE_BY_COUNT,
    COVARIANCE_STREAM,
    FILES,
    FUSION,
    GOLDEN,
    MANIFEST,
    OPTIONAL_FILES,
    PARAMETERS,
    SOURCE_COUNT,
    file_sha256,
    load_bundle,
)
from service.inference.localizer import Localizer, localizer_of
from service.inference.manifest import Graph, Manifest, Tensor
from service.inference.registry import golden_spectra, self_test

MAX_PARITY = 1e-3
"""Largest allowed difference of fused spectra, whose maximum is at most 1"""
GRAPH_FILES = {
    "covariance": COVARIANCE,
    "source_count": SOURCE_COUNT,
    "covariance_stream": COVARIANCE_STREAM,
}
CARDS = Path(__file__).parents[2] / "docs" / "models"
"""Folder of the model cards, ``<name>.md``"""
GOLDEN_ROOM = RoomSpec((5.0, 4.0, 2.8), (2.3, 1.9, 1.1), rt60=0.3)


@dataclass(frozen=True, slots=True)
class ExportGraph:
    """A network with the inputs, outputs and axes of its ONNX graph."""

    network: nn.Module
    examples: tuple[torch.Tensor, ...]
    """Example inputs: the features and, for a stream, its states as further arguments"""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dynamic: tuple[Mapping[int, str], ...]
    """Dynamic axes of every input: index to name"""


def export_onnx(graph: ExportGraph, path: Path) -> Graph:
    """Write one ONNX file and return its contract."""
    graph.network.eval()
    names = {name for axes in graph.dynamic for name in axes.values()}
    dims = {name: torch.export.Dim(name, min=1, max=65536) for name in names}
    shapes = [{axis: dims[name] for axis, name in axes.items()} for axes in graph.dynamic]
    states = [tuple(shapes[1:])] if len(shapes) > 1 else []  # the arguments behind a star
    # The exporter warns about its own internals and about libraries that it does not need.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            graph.network,
            graph.examples,
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_shapes=(shapes[0], *states),
            dynamo=True,
            optimize=True,
            verbose=False,
        )
    assert program is not None
    program.save(str(path), external_data=False)
    strip_metadata(path)
    return _contract(path)


def strip_metadata(path: Path) -> None:
    """Remove the exporter's stack traces from a graph: they hold the machine's paths."""
    model = onnx.load(path)
    graph = model.graph
    for part in (model, graph, *graph.node, *graph.value_info, *graph.input, *graph.output):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    for initializer in graph.initializer:
        initializer.ClearField("metadata_props")
    onnx.save(model, path)


def _contract(path: Path) -> Graph:
    """Names and shapes of the file's inputs and outputs."""
    model = onnx.load(path)

    def tensors(nodes: Any) -> list[Tensor]:
        return [
            Tensor(
                name=node.name,
                shape=[d.dim_param or d.dim_value for d in node.type.tensor_type.shape.dim],
            )
            for node in nodes
        ]

    return Graph(inputs=tensors(model.graph.input), outputs=tensors(model.graph.output))


def golden_windows(array: MicrophoneArray, count: int = 1, seed: int = 2026) -> FloatArray:
    """Windows (B, N, T) float32 of synthetic speech in a small room, without any corpus."""
    rng = np.random.default_rng(seed)
    voices = [synthetic_voice(rng, 1.2) for _ in range(4)]
    protocol = SceneProtocol(num_sources=1, room=GOLDEN_ROOM, snr_db=20.0, distance=(0.6, 1.5))
    scenes = [
        simulate_scene(protocol, voices, [seed, index], array=array).audio for index in range(count)
    ]
    # 16-bit values compress well, and every machine reads back the same numbers.
    return np.stack([np.round(0.1 * s * 32768) / 32768 for s in scenes]).astype(np.float32)


def write_bundle(
    folder: Path,
    fields: Mapping[str, Any],
    graphs: Mapping[str, ExportGraph],
    fusion: Mapping[str, FloatArray],
    parameters: Mapping[str, FloatArray],
    reference: Mapping[int, FloatArray],
    windows: FloatArray,
    array: MicrophoneArray,
    known: Mapping[int, ExportGraph] = MappingProxyType({}),
) -> Manifest:
    """Write a whole bundle and verify it as the service would.

    Parameters
    ----------
    fields : mapping
        The manifest's descriptive fields.
    graphs : mapping of str to ExportGraph
        Graphs by the manifest's fields; ``covariance_stream`` may be missing.
        fusion : mapping
            Arrays of the file ``FUSION``, the trained parameters outside of the graphs.
        parameters : mapping
        The training model's tensors (``parameters.parameter_arrays``), which fine-tuning reads.
    reference : mapping of int to (B, A) float32
        The torch pipelines' fused spectra of ``windows`` by the number of sources asked for, for
        every number of ``golden_spectra``.
    windows : (B, N, T) float32
    array : MicrophoneArray
        Array of the windows.
    known : mapping of int to ExportGraph, optional
        Covariance networks for one number of sources each.

    Raises
    ------
    ValueError
        If the service's spectra differ from the reference by more than ``MAX_PARITY``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    contracts = {name: export_onnx(g, folder / GRAPH_FILES[name]) for name, g in graphs.items()}
    by_count = {n: export_onnx(g, folder / COVARIANCE_BY_COUNT[n]) for n, g in known.items()}
    np.savez(folder / FUSION, **fusion)  # type: ignore[arg-type]
    np.savez(folder / PARAMETERS, **parameters)  # type: ignore[arg-type]
    golden = {"positions": array.positions, "windows": windows[:1]}
    np.savez_compressed(folder / GOLDEN, **golden)  # type: ignore[arg-type]
    copy_card(folder, fields["name"])
    draft = {**fields, **contracts, "covariance_by_count": by_count, "parity": {}}
    asked = golden_spectra(_write_manifest(folder, draft))
    localizer = localizer_of(load_bundle(folder), array)
    served = {count: _spectra(localizer, windows, count) for count in asked.values()}
    parity = _parity(served, reference)
    golden |= {name: served[count][:1] for name, count in asked.items()}
    np.savez_compressed(folder / GOLDEN, **golden)  # type: ignore[arg-type]
    manifest = _write_manifest(folder, {**draft, "parity": parity})
    self_test(load_bundle(folder))
    return manifest


def _spectra(localizer: Localizer, windows: FloatArray, num_sources: int) -> FloatArray:
    """The service's fused spectra (B, A) float32 of windows with so many sources asked for."""
    estimates = localizer.estimate(windows, num_sources, max(num_sources, 1))
    return np.stack([estimate.spectrum for estimate in estimates]).astype(np.float32)


def _parity(
    served: Mapping[int, FloatArray], reference: Mapping[int, FloatArray]
) -> dict[str, Any]:
    """The manifest's ``parity`` of spectra by the number of sources asked for."""
    differences = {n: float(np.abs(served[n] - reference[n]).max()) for n in served}
    largest = max(differences, key=lambda count: differences[count])
    if not differences[largest] <= MAX_PARITY:
        raise ValueError(
            f"torch and onnxruntime with numpy differ by {differences[largest]:.2g} where "
            f"{largest} sources are asked for, above {MAX_PARITY:g}"
        )
    return {
        "what": "largest difference of fused spectra, torch against onnxruntime with numpy",
        "windows": len(served[1]),
        "max_abs_difference": float(f"{differences[largest]:.3g}"),
        "by_num_sources": {str(n): float(f"{each:.3g}") for n, each in differences.items()},
        "bound": MAX_PARITY,
    }


def stft_section(frames: int) -> dict[str, int]:
    """The manifest's ``stft`` for networks trained on windows of ``frames`` frames."""
    return {
        "sample_rate": STFT.sample_rate,
        "n_fft": STFT.n_fft,
        "hop": STFT.hop,
        "frames": frames,
    }


def copy_card(folder: Path, name: str, cards: Path = CARDS) -> None:
    """Put the model card of this name into a bundle, if one is written."""
    card = cards / f"{name}.md"
    if card.is_file():
        shutil.copyfile(card, folder / CARD)


def update_scores(folder: Path, scores: Mapping[str, Any]) -> None:
    """Put an evaluation's scores into a bundle's manifest, and renew its card."""
    fields = json.loads((folder / MANIFEST).read_text())
    copy_card(folder, fields["name"])
    _write_manifest(folder, {**fields, "scores": dict(scores)})


def _write_manifest(folder: Path, fields: Mapping[str, Any]) -> Manifest:
    optional = [name for name in OPTIONAL_FILES if (folder / name).is_file()]
    hashes = {name: file_sha256(folder / name) for name in (*FILES, *optional)}
    manifest = Manifest.model_validate({**fields, "files": hashes})
    text = json.dumps(manifest.model_dump(), indent=2)
    (folder / MANIFEST).write_text(text + "\n")
    return manifest


def digest(state: Mapping[str, torch.Tensor]) -> str:
    """A short hash of trained parameters, to tie a bundle to its checkpoint."""
    joined = hashlib.sha256()
    for key in sorted(state):
        joined.update(key.encode())
        joined.update(state[key].contiguous().cpu().numpy().tobytes())
    return joined.hexdigest()[:16]
