"""``neuralmusic bench``: the cost of a window and a stream, beside pyroomacoustics."""

from __future__ import annotations

import argparse
import json
import os
from typing import TYPE_CHECKING, Any

from neuralmusic.errors import InvalidOption
from service.machine.environment import prepare_process

if TYPE_CHECKING:
    from service.bench.window import BenchResult, Timing

NAME = "bench"
SUMMARY = "time every stage of a window and the hop of a stream beside pyroomacoustics"

RATIOS = {
    "norm_music": "NormMUSIC, 257 bins",
    "norm_music_speech": "NormMUSIC, 300 to 3500 Hz",
    "neural": "neural window, the same bins",
    "neural_against_speech_band": "neural window, 300 to 3500 Hz there",
}
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, default=1, help="threads of BLAS and onnxruntime")
    parser.add_argument("--repeats", type=int, default=40, help="windows per array (default 40)")
    parser.add_argument(
        "--microphones", type=int, nargs="+", choices=(4, 8, 16), default=(4, 8, 16), help="arrays"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    prepare_process()
    for flag in ("threads", "repeats"):
        if getattr(args, flag) < 1:
            raise InvalidOption(f"--{flag} must be at least 1, but is {getattr(args, flag)}")
    # BLAS reads these when numpy is first imported: import nothing before that imports numpy.
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(args.threads)))
    from service.bench.window import bench, bench_arrays
    from service.inference.registry import BundleRegistry
    from service.machine.memory import keep_freed_memory

    keep_freed_memory()  # as the workers do
    bundles = BundleRegistry.load(threads=args.threads).bundles
    bundle = next(bundle for bundle in bundles if bundle.manifest.variant == "weights")
    arrays = bench_arrays()
    results = {count: bench(bundle, arrays[count], args.repeats) for count in args.microphones}
    if args.json:
        print(json.dumps(_document(results), indent=2))
    else:
        for result in results.values():
            _print(result)
    return 0


def _document(results: dict[int, BenchResult]) -> dict[str, Any]:
    """The first array's figures at the top, all arrays' by number of microphones below."""
    described = {str(count): _figures(result) for count, result in results.items()}
    return {**next(iter(described.values())), "arrays": described}


def _figures(result: BenchResult) -> dict[str, Any]:
    return {
        "array": result.array.name,
        "microphones": result.array.num_microphones,
        **{f"{name}_ms": _milliseconds(timing) for name, timing in _timings(result).items()},
        "stages_ms": {name: round(t.median, 4) for name, t in result.stages.items()},
        "stages_p99_ms": {name: round(t.p99, 4) for name, t in result.stages.items()},
        "stream_share_of_a_core": round(result.hop.median / 100, 4),
        "times_faster_than_pyroomacoustics": {
            name: dict(zip(("p25", "median", "p75"), (round(x, 2) for x in ratio), strict=True))
            for name, ratio in _ratios(result).items()
        },
    }


def _timings(result: BenchResult) -> dict[str, Timing]:
    peers = {
        f"pyroomacoustics_{name.lower()}_window": timing for name, timing in result.peers.items()
    }
    if result.peer_speech:
        peers["pyroomacoustics_normmusic_speech_window"] = result.peer_speech
    return {
        "neural_window": result.neural,
        "norm_music_window": result.norm_music,
        "norm_music_speech_window": result.norm_music_speech,
        "stream_hop": result.hop,
        **peers,
    }


def _ratios(result: BenchResult) -> dict[str, tuple[float, float, float]]:
    """Ratios to pyroomacoustics' NormMUSIC on the same windows and bins."""
    if not (result.peers and result.peer_speech):
        return {}
    return {
        "norm_music": result.norm_music.faster_than(result.peers["NormMUSIC"]),
        "norm_music_speech": result.norm_music_speech.faster_than(result.peer_speech),
        "neural": result.neural.faster_than(result.peers["NormMUSIC"]),
        "neural_against_speech_band": result.neural.faster_than(result.peer_speech),
    }


def _milliseconds(timing: Timing) -> dict[str, float]:
    return {"median": round(timing.median, 3), "p99": round(timing.p99, 3)}


def _print(result: BenchResult) -> None:
    from neuralmusic.cli.terminal import line, output, table

    console = output()
    microphones = result.array.num_microphones
    line(console, f"{result.array.name}, {microphones} microphones: CPU time of 1.04 s of audio")
    rows = table(console, "what", "median ms", "p99 ms", right=("median ms", "p99 ms"))
    named = {
        "neural window, 256 bins": result.neural,
        **{f"  {name}": timing for name, timing in result.stages.items()},
        "NormMUSIC, 257 bins": result.norm_music,
        "NormMUSIC, 300 to 3500 Hz": result.norm_music_speech,
        **{f"pyroomacoustics {n}, 257 bins": timing for n, timing in result.peers.items()},
    }
    if result.peer_speech:
        named["pyroomacoustics NormMUSIC, 300 to 3500 Hz"] = result.peer_speech
    named["stream, 100 ms of audio"] = result.hop
    for name, timing in named.items():
        rows.add_row(name, f"{timing.median:.2f}", f"{timing.p99:.2f}")
    console.print(rows)
    line(console, f"a stream at ten results a second takes {result.hop.median:.1f} % of a core")
    ratios = _ratios(result)
    if not ratios:
        line(console, "pyroomacoustics is not installed: make install for the comparison")
        return
    for name, (low, median, high) in ratios.items():
        line(
            console,
            f"{RATIOS[name]}: {median:.1f} times faster than pyroomacoustics' NormMUSIC "
            f"(quartiles {low:.1f} to {high:.1f})",
        )
    console.print()
