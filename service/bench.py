"""Cost of one window by stage, beside pyroomacoustics' NormMUSIC on the same windows.

CPU time of one thread after a warm-up; medians, since other programs disturb single runs. Absolute
times tell of the machine, ratios of the program.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.candidates import find_candidates
from service.inference.classical import BAND, ClassicalLocalizer
from service.inference.localizer import localizer_of
from service.inference.weights import (
    CandidateSearch,
    analysis_of,
    block_means,
    cell_covariances,
    principal_eigenvectors,
)

T = TypeVar("T")
WINDOW_SAMPLES = 16640
"""64 frames"""


@dataclass(frozen=True, slots=True)
class Timing:
    """Milliseconds of CPU time per window."""

    median: float
    p99: float


@dataclass(frozen=True, slots=True)
class BenchResult:
    """Timings of one array's windows."""

    array: str
    microphones: int
    neural: Timing
    norm_music: Timing
    peer: Timing | None
    """pyroomacoustics' NormMUSIC, None where it is not installed"""
    stages: dict[str, Timing]

    @property
    def ratio(self) -> float | None:
        """The neural window's median over the peer's."""
        return self.neural.median / self.peer.median if self.peer else None


def bench(bundle: Bundle, array: MicrophoneArray, repeats: int = 40, seed: int = 1) -> BenchResult:
    """Time every stage of a `weights` bundle on ``repeats`` windows of two moving noises."""
    windows = [bench_window(array, seed + index) for index in range(repeats)]
    localizer = localizer_of(bundle, array)
    classical = ClassicalLocalizer("norm_music", array)
    return BenchResult(
        array=array.name,
        microphones=array.num_microphones,
        neural=_time(lambda window: localizer.estimate(window[None], None, 3), windows),
        norm_music=_time(lambda window: classical.estimate(window[None], 2, 2), windows),
        peer=_time_peer(array, windows),
        stages=_time_stages(bundle, array, windows),
    )


def bench_window(array: MicrophoneArray, seed: int) -> FloatArray:
    """Two noises that come and go from two directions, with sensor noise: (N, T) float32."""
    rng = np.random.default_rng(seed)
    directions = unit_vectors(rng.uniform(0, 2 * np.pi, 2))
    omega = 2 * np.pi * np.fft.rfftfreq(WINDOW_SAMPLES, 1 / 16000)
    audio = 0.02 * rng.standard_normal((array.num_microphones, WINDOW_SAMPLES))
    for direction in directions:
        envelope = np.repeat(rng.uniform(0, 1, 16) ** 2, WINDOW_SAMPLES // 16)
        spectrum = np.fft.rfft(envelope * rng.standard_normal(WINDOW_SAMPLES))
        advance = array.positions @ direction / 343.0
        audio += np.fft.irfft(spectrum * np.exp(1j * omega * advance[:, None]), WINDOW_SAMPLES)
    return (0.1 * audio).astype(np.float32)


def _time_stages(
    bundle: Bundle, array: MicrophoneArray, windows: Sequence[FloatArray]
) -> dict[str, Timing]:
    """The stages one by one, each on what the stage before gives."""
    search = CandidateSearch(bundle.covariance, analysis_of(bundle), array)
    spectra = [search.spectra(window[None]) for window in windows]
    weighed = [search.weigh(s) for s in spectra]
    weights = [(s[0], w[0][0]) for s, w in zip(spectra, weighed, strict=True)]
    covariances = [cell_covariances(*pair) for pair in weights]
    principals = [principal_eigenvectors(covariance) for covariance in covariances]
    fields = [
        search.field(search.cell_spectra(principal), block_means(weighing[1][0]), dominance)
        for (principal, dominance), weighing in zip(principals, weighed, strict=True)
    ]
    descriptors = [find_candidates(field).descriptors[None] for field in fields]
    return {
        "stft": _time(lambda window: search.spectra(window[None]), windows),
        "covariance_net": _time(search.weigh, spectra),
        "covariance": _time(lambda pair: cell_covariances(*pair), weights),
        "evd": _time(principal_eigenvectors, covariances),
        "spectrum": _time(lambda pair: search.cell_spectra(pair[0]), principals),
        "fusion_and_peaks": _time(find_candidates, fields),
        "count_net": _time(lambda each: bundle.source_count.run([each]), descriptors),
    }


def _time_peer(array: MicrophoneArray, windows: Sequence[FloatArray]) -> Timing | None:
    try:
        import pyroomacoustics
    except ImportError:
        return None
    stft = Stft()
    method = pyroomacoustics.doa.algorithms["NormMUSIC"](
        array.positions.T, stft.sample_rate, stft.n_fft, num_src=2, n_grid=360, dim=2
    )

    def locate(spectra: ComplexArray) -> None:
        method.locate_sources(spectra, freq_range=list(BAND))

    return _time(locate, [stft.transform(window) for window in windows])


def _time(work: Callable[[T], object], inputs: Sequence[T]) -> Timing:
    for each in inputs[:3]:
        work(each)
    spent = []
    for each in inputs:
        start = time.process_time()
        work(each)
        spent.append(1000 * (time.process_time() - start))
    return Timing(float(np.median(spent)), float(np.percentile(spent, 99)))
