"""What windows and a stream's step cost here and in another checkout, in turns.

On a shared machine the same work takes half as long again from one second to the next. So two
processes, one of each checkout, take turns of some milliseconds, and the ratio of each pair counts:

    git worktree add ../before v1.2.3
    python tests/bench/pairs.py ../before
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import cycle
from pathlib import Path
from typing import Literal, get_args

import numpy as np

ROOT = Path(__file__).parents[2]
ARRAY = "respeaker-usb-4mic-v2"
WINDOWS = 3
"""Windows in a turn"""
STREAMS = 8
"""Streams that take a step each in a turn, so that caches are as cold as in a service"""
WARM_UP = 15

Work = Literal["window", "classical", "step"]
"""Kinds of work: a neural window, one of NormMUSIC in 257 bins, 100 ms of a stream"""


class Turns:
    """A process of one checkout, by its own copy of this file, that works when asked to."""

    def __init__(self, checkout: Path, work: Work) -> None:
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, checkout / "tests/bench/pairs.py", checkout, "--turns", work],
            env={**os.environ, **threads, "PYTHONPATH": f"{checkout / 'client'}:{checkout}"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def take(self) -> float:
        """One turn; its CPU milliseconds per window or step."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def end(self) -> None:
        """End the process."""
        self._process.communicate()


def compare(before: Path, work: Work, pairs: int) -> str:
    """A line for this work; the checkouts change places from pair to pair."""
    old, new = Turns(before, work), Turns(ROOT, work)
    spent: list[tuple[float, float]] = []
    for number in range(pairs):
        if number % 2:
            now = new.take()
            spent.append((old.take(), now))
        else:
            spent.append((old.take(), new.take()))
    old.end()
    new.end()
    before_ms, now_ms = np.median(spent, axis=0)
    low, ratio, high = np.percentile([now / then for then, now in spent], [25, 50, 75])
    return (
        f"{work:11}{before_ms:6.2f} ms before,{now_ms:6.2f} now, in pairs {ratio:.3f} "
        f"({low:.3f} to {high:.3f})"
    )


def take_turns(work: Work) -> None:
    """Work at every line that comes in, answer with the milliseconds."""
    from service.machine.memory import keep_freed_memory

    keep_freed_memory()  # as the workers do
    turns = _steps() if work == "step" else _windows(work)
    for _ in range(WARM_UP):
        next(turns)()
    for _ in sys.stdin:
        turn = next(turns)
        began = time.process_time_ns()
        done = turn()
        print((time.process_time_ns() - began) / done / 1e6, flush=True)


def _windows(work: Work) -> Iterator[Callable[[], int]]:
    from service.bench.window import WHOLE_BAND, bench_window
    from service.doa.presets import preset
    from service.inference.bundle import load_bundle
    from service.inference.classical import ClassicalLocalizer
    from service.inference.localizer import localizer_of

    array = preset(ARRAY)
    localizer = (
        localizer_of(load_bundle(ROOT / "service/models/any-array"), array)
        if work == "window"
        else ClassicalLocalizer("norm_music", array, band=WHOLE_BAND)
    )
    windows = [bench_window(array, seed) for seed in range(4)]

    def turn() -> int:
        for window in windows[:WINDOWS]:
            localizer.estimate(window[None], 2, 2)
        windows.append(windows.pop(0))
        return WINDOWS

    return cycle([turn])


def _steps() -> Iterator[Callable[[], int]]:
    import soundfile

    from neuralmusic.protocol.client_messages import OutputOptions
    from service.bench.window import bench_pieces, bench_pipeline
    from service.doa.presets import preset
    from service.inference.bundle import load_bundle

    bundle, array = load_bundle(ROOT / "service/models/any-array"), preset(ARRAY)
    audio, _ = soundfile.read(ROOT / "examples/two-talkers.flac", dtype="float32")
    pipelines = [bench_pipeline(bundle, array) for _ in range(STREAMS)]
    output = OutputOptions(interval_ms=100)
    for place in range(10**6):
        samples = np.roll(audio, -1600 * place, axis=0)[:1600]
        (piece,) = bench_pieces(samples.T)
        piece = type(piece)(1600 * place, piece.data, 0.0, None)

        def turn(piece: object = piece) -> int:
            for pipeline in pipelines:
                pipeline.step([piece], output)
            return STREAMS

        yield turn


def main() -> None:
    """Compare, or take turns for who compares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("before", type=Path, help="the other checkout")
    parser.add_argument("--pairs", type=int, default=400)
    parser.add_argument("--turns", choices=get_args(Work), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.turns:
        take_turns(asked.turns)
        return
    for work in get_args(Work):
        print(compare(asked.before.resolve(), work, asked.pairs), flush=True)


if __name__ == "__main__":
    main()
