"""What grows with what: CPU time against microphones, audio and sessions, by a fit.

A fit of a power law over several sizes, the least of several runs at each: other programs only ever
add, and bounds leave room, so that what fails here is another order of growth.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import soundfile

from neuralmusic.protocol.client_messages import OutputOptions
from service.audio.recording import Recording
from service.bench.window import bench_pieces, bench_pipeline, bench_window, cpu_ms
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.inference.bundle import Bundle
from service.inference.localizer import localizer_of
from service.inference.registry import BundleRegistry
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions

pytestmark = pytest.mark.costs

SQUARE = preset("respeaker-usb-4mic-v2")
LINEAR, QUADRATIC = 1.25, 2.2
"""Largest exponents, with room for noise"""
RUNS = 3


@pytest.fixture(scope="module")
def registry() -> BundleRegistry:
    return BundleRegistry.load()


@pytest.fixture(scope="module")
def bundle(registry: BundleRegistry) -> Bundle:
    return registry.bundles[0]


def least_s(work: Callable[[], object]) -> float:
    """Seconds of CPU time of the quickest of several runs, after one that does not count."""
    work()
    return min(cpu_ms(work) for _ in range(RUNS)) / 1000


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Exponent of the power law through points, by least squares of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def ring(microphones: int) -> MicrophoneArray:
    angle = np.arange(microphones) * (2 * np.pi / microphones)
    positions = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return MicrophoneArray("ring", positions)


def test_the_fit_tells_orders_apart() -> None:
    sizes = [4, 8, 16, 32]
    assert exponent(sizes, [3 * n**2 for n in sizes]) == pytest.approx(2)
    assert exponent(sizes, [5 + n**3 for n in sizes]) > QUADRATIC


def test_a_window_costs_at_most_the_square_of_its_microphones(bundle: Bundle) -> None:
    sizes = [4, 8, 16, 32]
    times = []
    for microphones in sizes:
        array = ring(microphones)
        localizer = localizer_of(bundle, array)
        window = bench_window(array, 1)[None]
        times.append(least_s(lambda one=localizer, w=window: one.estimate(w, None, 3)))
    assert exponent(sizes, times) < QUADRATIC


def test_a_recording_costs_in_proportion_to_its_length(registry: BundleRegistry) -> None:
    sizes = [2, 4, 8, 16]
    options = LocalizeOptions(array=SQUARE)

    def localize(seconds: int) -> None:
        audio = bench_window(SQUARE, 1, samples=16000 * seconds)
        file = io.BytesIO()
        soundfile.write(file, audio.T, 16000, format="WAV", subtype="PCM_16")
        file.seek(0)
        with Recording.open(file) as recording:
            localize_recording(recording, options, registry)

    times = [least_s(lambda seconds=seconds: localize(seconds)) for seconds in sizes]
    assert exponent(sizes, times) < LINEAR


def test_streams_cost_in_proportion_to_their_number(bundle: Bundle) -> None:
    sizes = [1, 2, 4, 8]
    pieces = bench_pieces(bench_window(SQUARE, 1))
    output = OutputOptions(interval_ms=100)

    def stream(count: int) -> None:
        pipelines = [bench_pipeline(bundle, SQUARE) for _ in range(count)]
        for piece in pieces:
            for pipeline in pipelines:
                pipeline.step([piece], output)

    times = [least_s(lambda count=count: stream(count)) for count in sizes]
    assert exponent(sizes, times) < LINEAR
