"""Cost of one window and of one hop of a stream, by stage, beside pyroomacoustics.

CPU time of this process after a warm-up. Absolute times tell about the machine, ratios about the
program. A machine's speed may change from one second to the next, so every method takes the same
windows, a few at a time in turns, and a ratio is the median of the windows' ratios.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from neuralmusic.protocol.client_messages import AudioFormat, OutputOptions
from service.bench.stages import window_stages
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.bundle import Bundle
from service.inference.classical import BAND, ClassicalLocalizer
from service.inference.localizer import localizer_of
from service.streaming.buffer import Piece
from service.streaming.pipeline import StreamPipeline, StreamPlan

SAMPLE_RATE = 16_000
WINDOW_SAMPLES = 16_640
"""Samples in a window of 64 frames"""
HOP_S = 0.1
"""Seconds between the results of a stream"""
WARM_UP = 5
TURN = 5
"""Windows that a method takes in one turn, after one that fills the caches and does not count"""
WHOLE_BAND = (0.0, 8000.0)
"""Hertz, all 257 bins: the neural window uses them, speech needs fewer"""
RING_RADIUS = 0.1
PEERS = ("NormMUSIC", "MUSIC", "SRP")

Work = Callable[[FloatArray], object]
Workload = tuple[Callable[[Any], object], Sequence[Any]]
"""A function and its inputs, one call each"""
InputT = TypeVar("InputT")


@dataclass(frozen=True, slots=True)
class Timing:
    """CPU times of one method, milliseconds."""

    spent: FloatArray
    """Times of the windows in order"""

    @property
    def median(self) -> float:
        return float(np.median(self.spent))

    @property
    def p99(self) -> float:
        return float(np.percentile(self.spent, 99))

    def faster_than(self, other: Timing) -> tuple[float, float, float]:
        """Ratio of times per window, other over own: lower quartile, median, upper quartile."""
        low, median, high = np.percentile(other.spent / self.spent, [25, 50, 75])
        return float(low), float(median), float(high)


@dataclass(frozen=True, slots=True)
class BenchResult:
    """Timings of one array."""

    array: MicrophoneArray
    neural: Timing
    norm_music: Timing
    """NormMUSIC in the whole band, 257 bins"""
    norm_music_speech: Timing
    """NormMUSIC in the service's own band, 300 to 3500 Hz"""
    peers: Mapping[str, Timing]
    """pyroomacoustics' methods in the whole band, its own STFT included; empty without it"""
    peer_speech: Timing | None
    """pyroomacoustics' NormMUSIC, 300 to 3500 Hz"""
    hop: Timing
    """Cost of 100 ms of a stream, from PCM to tracks"""
    stages: Mapping[str, Timing]


def bench_arrays() -> dict[int, MicrophoneArray]:
    """Arrays of 4, 8 and 16 microphones."""
    angle = np.arange(16) * (2 * np.pi / 16)
    ring = RING_RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return {
        4: preset("respeaker-usb-4mic-v2"),
        8: preset("av163-circle8"),
        16: MicrophoneArray("ring of 16", ring),
    }


def bench(bundle: Bundle, array: MicrophoneArray, repeats: int = 40, seed: int = 1) -> BenchResult:
    """Time a `weights` bundle on ``repeats`` windows of two intermittent noises."""
    windows = [bench_window(array, seed + index) for index in range(repeats)]
    localizer = localizer_of(bundle, array)
    wide = ClassicalLocalizer("norm_music", array, band=WHOLE_BAND)
    speech = ClassicalLocalizer("norm_music", array)
    works: dict[str, Work] = {
        "neural": lambda window: localizer.estimate(window[None], None, 3),
        "norm_music": lambda window: wide.estimate(window[None], 2, 2),
        "norm_music_speech": lambda window: speech.estimate(window[None], 2, 2),
        **dict(_peers(array)),
    }
    tasks: dict[str, Workload] = {name: (work, windows) for name, work in works.items()}
    timed = _in_turns({**tasks, "hop": _hops(bundle, array, windows)}, -(-repeats // (TURN + 1)))
    return BenchResult(
        array=array,
        neural=timed["neural"],
        norm_music=timed["norm_music"],
        norm_music_speech=timed["norm_music_speech"],
        peers={name: timed[name] for name in PEERS if name in timed},
        peer_speech=timed.get("NormMUSIC, speech"),
        hop=timed["hop"],
        stages={
            name: _time(work, inputs)
            for name, work, inputs in window_stages(bundle, array, windows)
        },
    )


def bench_window(array: MicrophoneArray, seed: int, samples: int = WINDOW_SAMPLES) -> FloatArray:
    """Two intermittent noises from two directions, with sensor noise: (N, T) float32."""
    rng = np.random.default_rng(seed)
    directions = unit_vectors(rng.uniform(0, 2 * np.pi, 2))
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / SAMPLE_RATE)
    audio = 0.02 * rng.standard_normal((array.num_microphones, samples))
    for direction in directions:
        envelope = np.repeat(rng.uniform(0, 1, 16) ** 2, samples // 16)
        spectrum = np.fft.rfft(envelope * rng.standard_normal(samples))
        advance = array.positions @ direction / 343.0
        audio += np.fft.irfft(spectrum * np.exp(1j * omega * advance[:, None]), samples)
    return (0.1 * audio).astype(np.float32)


def _peers(array: MicrophoneArray) -> Iterator[tuple[str, Work]]:
    """pyroomacoustics as its users run it: its STFT, 360 azimuths, two sources."""
    try:
        import pyroomacoustics as pra
    except ImportError:
        return
    bands = [(name, name, WHOLE_BAND) for name in PEERS]
    hann = pra.hann(512)

    def locate(doa: Any, band: tuple[float, float], window: FloatArray) -> None:
        spectra = pra.transform.stft.analysis(window.T, 512, 256, win=hann)
        doa.locate_sources(spectra.transpose(2, 1, 0), freq_range=list(band))

    for name, method, band in [*bands, ("NormMUSIC, speech", "NormMUSIC", BAND)]:
        doa = pra.doa.algorithms[method](
            array.positions.T, SAMPLE_RATE, 512, num_src=2, n_grid=360, dim=2
        )
        yield name, partial(locate, doa, band)


def _hops(bundle: Bundle, array: MicrophoneArray, windows: Sequence[FloatArray]) -> Workload:
    """Steps of 100 ms of a stream with the windows' audio."""
    pipeline = bench_pipeline(bundle, array)
    output = OutputOptions(interval_ms=round(1000 * HOP_S))
    pieces = bench_pieces(np.concatenate(windows, axis=1))
    return lambda piece: pipeline.step([piece], output), pieces


def bench_pipeline(bundle: Bundle, array: MicrophoneArray) -> StreamPipeline:
    """The pipeline of a stream of 16-bit samples with one channel per microphone."""
    microphones = array.num_microphones
    audio = AudioFormat(encoding="pcm_s16le", sample_rate=SAMPLE_RATE, channels=microphones)
    channel_map = tuple(range(microphones))
    return StreamPipeline(StreamPlan(audio, array, channel_map, "neural", bundle, bundle.stft))


def bench_pieces(audio: FloatArray) -> list[Piece]:
    """Audio (N, T) as pieces of 100 ms of that stream."""
    hop = round(HOP_S * SAMPLE_RATE)
    pcm = np.clip(32768 * audio.T, -32768, 32767).astype("<i2")
    starts = range(0, len(pcm) - hop + 1, hop)
    return [Piece(start, pcm[start : start + hop].tobytes(), 0.0, None) for start in starts]


def _in_turns(tasks: Mapping[str, Workload], turns: int) -> dict[str, Timing]:
    """Time every task on all of its inputs, a share of them in each turn."""
    spent: dict[str, list[float]] = {name: [] for name in tasks}
    for work, inputs in tasks.values():
        for each in inputs[:WARM_UP]:
            work(each)
    for turn in range(turns):
        for name, (work, inputs) in tasks.items():
            begin, end = (k * len(inputs) // turns for k in (turn, turn + 1))
            times = [cpu_ms(partial(work, each)) for each in inputs[begin:end]]
            spent[name] += times[1:] or times
    return {name: Timing(np.array(times)) for name, times in spent.items()}


def _time(work: Callable[[InputT], object], inputs: Sequence[InputT]) -> Timing:
    """Time the work on every input, after a warm-up."""
    for each in inputs[:WARM_UP]:
        work(each)
    return Timing(np.array([cpu_ms(partial(work, each)) for each in inputs]))


def cpu_ms(work: Callable[[], object]) -> float:
    """Milliseconds of CPU time of all threads."""
    start = time.process_time_ns()
    work()
    return (time.process_time_ns() - start) / 1e6
