"""The least time that a window's stages could take: operations and bytes against this CPU's peaks.

Operations are those of the formulas, real multiplications and additions; bytes are what has to come
from or go to memory that outlives a stage. A stage cannot be quicker than either allows. What lies
between is Python's calls, short vectors, small matrices, and caches that the stage before filled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
from onnx import helper

from service.bench.window import cpu_ms
from service.doa.evd import APPLICATIONS, SQUARINGS
from service.inference.engine import Engine
from service.inference.registry import EMBEDDED_MODELS

BINS, FRAMES, FFT, AZIMUTHS = 256, 64, 512, 180
ROWS, ROUNDS = 5, 4
COMPLEX, REAL = 8, 4
"""Bytes"""


def roofline(stages_ms: dict[str, float], microphones: int = 4) -> dict[str, Any]:
    """Peaks, and every stage's operations, bytes, least and measured milliseconds."""
    gflops, gigabytes = peak_gflops(), peak_gigabytes()
    rows = {}
    for name, (operations, moved) in demands(microphones).items():
        least = 1e3 * max(operations / (gflops * 1e9), moved / (gigabytes * 1e9))
        rows[name] = {
            "mflop": round(operations / 1e6, 2),
            "megabytes": round(moved / 1e6, 2),
            "least_ms": round(least, 3),
            "measured_ms": round(stages_ms[name], 3),
        }
    return {"gflops": round(gflops), "gigabytes_per_s": round(gigabytes), "stages": rows}


def demands(n: int) -> dict[str, tuple[float, float]]:
    """Operations and bytes of every stage for ``n`` microphones, up to four of them."""
    cells, spectra = BINS * FRAMES, n * BINS * FRAMES * COMPLEX
    matrices = ROWS * BINS
    values = matrices * AZIMUTHS
    products = 1 + n * (n - 1)
    return {
        "stft": (n * FRAMES * (FFT + 2.5 * FFT * np.log2(FFT)), n * FRAMES * FFT * REAL + spectra),
        "features": (cells * (n * (3 + 2 + 3 * 8) + 25), 2 * spectra + 5 * cells * REAL),
        "covariance_net": (network_operations(), 7 * cells * REAL),
        "covariance": (
            cells * (2 * n + 8 * n * (n + 1) / 2),
            spectra + matrices * n * n * COMPLEX,
        ),
        "evd": (
            matrices * (SQUARINGS * 8 * n**3 + APPLICATIONS * 8 * n * n + 20 * n * n),
            matrices * n * n * COMPLEX,
        ),
        "spectrum": (
            values * (2 * products + 2),
            (BINS * products * AZIMUTHS + values) * REAL,
        ),
        "fusion": (ROUNDS * 2 * values, ROUNDS * values * REAL),
    }


def network_operations() -> float:
    """Operations of the convolutions of the embedded covariance network over a window."""
    path = EMBEDDED_MODELS / "any-array" / "covariance.onnx"
    graph = onnx.shape_inference.infer_shapes(onnx.load(path)).graph
    kernels = {each.name: each.dims for each in graph.initializer}
    shapes = {each.name: each.type.tensor_type.shape.dim for each in graph.value_info}
    return sum(
        2 * float(np.prod(kernels[node.input[1]])) * FRAMES * shapes[node.output[0]][-1].dim_value
        for node in graph.node
        if node.op_type == "Conv"
    )


def peak_gflops() -> float:
    """Float32 peak of one thread: the best of BLAS on large matrices and of a large convolution."""
    rng, side, channels = np.random.default_rng(0), 1024, 64
    matrix = rng.random((side, side), dtype=np.float32)
    image = rng.random((1, channels, 64, 64), dtype=np.float32)
    engine = Engine(_convolution(channels), "peak")
    return max(
        2 * side**3 / _least_s(lambda: matrix @ matrix) / 1e9,
        18 * channels * image.size / _least_s(lambda: engine.run([image])) / 1e9,
    )


def _convolution(channels: int) -> bytes:
    """A graph of one convolution of 3 x 3."""
    shape = [1, channels, 64, 64]
    kernel = np.ones((channels, channels, 3, 3), dtype=np.float32)
    graph = helper.make_graph(
        [helper.make_node("Conv", ["x", "w"], ["y"], pads=[1, 1, 1, 1])],
        "peak",
        [helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, shape)],
        [onnx.numpy_helper.from_array(kernel, "w")],
    )
    opset = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=8)
    content: bytes = model.SerializeToString()
    return content


def peak_gigabytes() -> float:
    """Memory bandwidth of one thread: reading and writing more than a core's cache holds."""
    source = np.zeros(16 * 2**20, dtype=np.float32)
    target = np.empty_like(source)
    return 2 * source.nbytes / _least_s(lambda: np.copyto(target, source)) / 1e9


def _least_s(work: Callable[[], object], runs: int = 10) -> float:
    return min(cpu_ms(work) for _ in range(runs)) / 1000
