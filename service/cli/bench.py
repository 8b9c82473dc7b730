"""``neuralmusic bench``: what a window costs, beside pyroomacoustics in the same run."""

from __future__ import annotations

import argparse
import json
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.bench import BenchResult, Timing

NAME = "bench"
SUMMARY = "time every stage of a window beside pyroomacoustics' NormMUSIC"

ARRAYS = ("respeaker-usb-4mic-v2", "av163-circle8")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, default=1, help="threads of BLAS and onnxruntime")
    parser.add_argument("--repeats", type=int, default=40, help="windows per array")
    parser.add_argument("--array", action="append", metavar="NAME", help="a preset, repeatable")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    # BLAS reads these when numpy is first imported, so nothing before may import it.
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(args.threads)))
    from service.bench import bench
    from service.doa.presets import preset
    from service.inference.registry import BundleRegistry

    bundles = BundleRegistry.load(threads=args.threads).bundles
    bundle = next(bundle for bundle in bundles if bundle.manifest.variant == "weights")
    results = [bench(bundle, preset(name), args.repeats) for name in args.array or ARRAYS]
    if args.json:
        print(json.dumps(_document(results), indent=2))
    else:
        _print(results)
    return 0


def _document(results: list[BenchResult]) -> dict[str, Any]:
    """The first array's figures at the top, all arrays' below."""
    described = {result.array: _figures(result) for result in results}
    return {**described[results[0].array], "arrays": described}


def _figures(result: BenchResult) -> dict[str, Any]:
    return {
        "microphones": result.microphones,
        "neural_window_ms": _milliseconds(result.neural),
        "norm_music_window_ms": _milliseconds(result.norm_music),
        "pyroomacoustics_norm_music_window_ms": result.peer and _milliseconds(result.peer),
        "ratio_to_pyroomacoustics": result.ratio and round(result.ratio, 3),
        "stages_ms": {name: _milliseconds(timing) for name, timing in result.stages.items()},
    }


def _milliseconds(timing: Timing) -> dict[str, float]:
    return {"median": round(timing.median, 3), "p99": round(timing.p99, 3)}


def _print(results: list[BenchResult]) -> None:
    from service.cli.terminal import line, output, table

    console = output()
    for result in results:
        line(console, f"{result.array}, {result.microphones} microphones: CPU time per window")
        rows = table(console, "what", "median ms", "p99 ms", right=("median ms", "p99 ms"))
        named = {
            **{f"  {name}": timing for name, timing in result.stages.items()},
            "neural window, whole": result.neural,
            "classical NormMUSIC": result.norm_music,
        }
        if result.peer:
            named["pyroomacoustics NormMUSIC"] = result.peer
        for name, timing in named.items():
            rows.add_row(name, f"{timing.median:.2f}", f"{timing.p99:.2f}")
        console.print(rows)
        if result.ratio is not None:
            line(console, f"the neural window takes {result.ratio:.2f} times pyroomacoustics'")
        else:
            line(console, "pyroomacoustics is not installed: make install for the comparison")
