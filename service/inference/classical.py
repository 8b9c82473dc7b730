"""Classical localizers behind the same interface as the networks, for any array."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from neuralmusic.protocol.methods import Method
from service.doa import classical
from service.doa.array import MicrophoneArray
from service.doa.covariance import sample_covariance
from service.doa.mirror import searched_half
from service.doa.pair_products import pair_products
from service.doa.peaks import find_peaks
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance, Whitening
from service.inference.results import Source, WindowEstimate

BAND = (300.0, 3500.0)
"""Hertz: below, small arrays see no delay; above, speech is weak and delays are ambiguous"""
RELATIVE_HEIGHT = 0.6
"""Least height of a source's peak above the mean, against the highest peak's"""
LEAST_CONTRAST = {"norm_music": 0.32, "music": 0.32, "srp_phat": 0.24}
"""Least 1 - mean / peak of a spectrum with a direction; white and diffuse noise stay below"""
LEAST_RESPONSE = 0.03
"""Least peak of SRP-PHAT's response, 1 for a plane wave; white noise stays below 0.02"""


class Grid:
    """Steering vectors (F, N, A) and, where there are any, their products."""

    def __init__(self, steering: ComplexArray) -> None:
        self.steering = steering
        self.products = pair_products(steering)


class Curve(NamedTuple):
    """A logistic curve of a peak's contrast, which is 1 - mean / peak."""

    slope: float
    middle: float

    def at(self, contrast: float) -> float:
        """The chance that a source is within 10 degrees of a peak of this contrast."""
        return 1 / (1 + math.exp(-self.slope * (contrast - self.middle)))


class Chances(NamedTuple):
    """The confidence of a method's peaks."""

    counted: Curve
    """Chance of the peaks that stand out"""
    asked: Curve
    """Chance of the peaks where their number is given"""
    undirected: float
    """Chance where the spectrum has no direction: its peaks are mostly noise"""


CHANCES: Mapping[Method, Chances] = {
    "norm_music": Chances(Curve(7.2, 0.15), Curve(3.1, 0.21), 0.19),
    "music": Chances(Curve(4.7, 0.17), Curve(1.4, 0.35), 0.03),
    "srp_phat": Chances(Curve(10.7, 0.27), Curve(5.4, 0.16), 0.19),
}
"""Chances by method, fitted to 1,800 simulated windows by
``python -m model_export classical-confidence``"""

_shared: WeakValueDictionary[tuple[bytes, bytes], Grid] = WeakValueDictionary()


def shared_grid(positions: FloatArray, frequencies: FloatArray) -> Grid:
    """The grid of an array (N, 3); users share one instance, which takes megabytes."""
    key = (positions.tobytes(), frequencies.tobytes())
    grid = _shared.get(key)
    if grid is None:
        grid = _shared[key] = Grid(steering_vectors(positions, frequencies, azimuth_grid()))
    return grid


class ClassicalLocalizer:
    """MUSIC, NormMUSIC or SRP-PHAT on windows of one array's audio."""

    def __init__(
        self,
        method: Method,
        array: MicrophoneArray,
        stft: Stft | None = None,
        noise: NoiseCovariance | None = None,
        *,
        band: tuple[float, float] = BAND,
    ) -> None:
        self._method = method
        self._stft = stft or Stft()
        frequencies = self._stft.frequencies
        # A slice: an array of bins would copy every window's spectra.
        self._band = slice(
            int(np.searchsorted(frequencies, band[0])),
            int(np.searchsorted(frequencies, band[1], side="right")),
        )
        self._grid = shared_grid(array.steered, frequencies[self._band])
        self._whitening: Whitening | None = None
        if noise is not None:
            self._whitening = Whitening.fitting(noise, array, self._stft).band(self._band)
            self._grid = Grid(self._whitening.steering(self._grid.steering))
        self._searched = searched_half(array, azimuth_grid())
        self.grid_size = len(self._searched)
        self._most_sources = array.num_microphones - 1

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window (B, N, T); without a known count, all distinct peaks."""
        return [
            self.localize(self.covariance(window), num_sources, max_sources)
            for window in self._stft.transform(windows)
        ]

    def covariance(self, spectra: ComplexArray) -> ComplexArray:
        """The method's covariances of spectra (N, F, L): (F', N, N), a mean over frames."""
        band = spectra[:, self._band]
        if self._whitening is not None:
            band = self._whitening.apply(band)
        return sample_covariance(
            classical.phase_transform(band) if self._method == "srp_phat" else band
        )

    def localize(
        self, covariance: ComplexArray, num_sources: int | None, max_sources: int
    ) -> WindowEstimate:
        """Directions from the output of ``covariance``."""
        dimension = min(num_sources or 1, self._most_sources)
        return self._pick(self.spectrum(covariance, dimension), num_sources, max_sources)

    def spectrum(self, covariance: ComplexArray, num_sources: int) -> FloatArray:
        """Broadband spectrum (A,) from the output of ``covariance``."""
        if self._method == "srp_phat":
            return np.maximum(classical.srp_phat(covariance, self._grid.steering), 0)
        method = classical.music if self._method == "music" else classical.norm_music
        return method(covariance, self._grid.steering, num_sources, self._grid.products)

    def _pick(
        self, spectrum: FloatArray, num_sources: int | None, max_sources: int
    ) -> WindowEstimate:
        """The given number of peaks, or all that stand out where the spectrum has a direction."""
        highest = float(spectrum.max())
        scaled = spectrum / np.float32(highest) if highest > 0 else spectrum
        peaks = find_peaks(np.where(self._searched, scaled, 0), num_sources or max_sources)
        mean = float(scaled.mean())
        directed = 1 - mean >= LEAST_CONTRAST[self._method]
        if self._method == "srp_phat":
            directed = directed and highest >= LEAST_RESPONSE
        chances = CHANCES[self._method]
        curve = chances.asked if num_sources else chances.counted
        if num_sources is None:
            level = mean + RELATIVE_HEIGHT * (1 - mean)
            peaks = [peak for peak in peaks if directed and peak.height >= level]
        sources = tuple(
            Source(
                peak.azimuth,
                curve.at(1 - mean / max(peak.height, mean)) if directed else chances.undirected,
            )
            for peak in peaks
        )
        return WindowEstimate(sources, scaled)
