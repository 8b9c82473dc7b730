"""Classical localizers behind the same interface as the networks, for any array.

Arrays that tell elevations are searched on the sphere, as the networks search them: on a geodesic
grid, and from its peaks uphill in steps of 2.5 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa import classical
from service.doa.array import MicrophoneArray
from service.doa.covariance import sample_covariance
from service.doa.evd import signal_subspace
from service.doa.fusion import mean_fusion, normalised_fusion
from service.doa.hemisphere import searched_directions
from service.doa.mirror import searched_half
from service.doa.music import music_spectrum
from service.doa.pair_products import PairProducts, pair_products
from service.doa.peaks import find_peaks
from service.doa.sphere import NUM_AZIMUTHS, azimuth_elevation, climbed
from service.doa.steering import azimuth_grid, direction_steering, unit_vectors
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance, Whitening, whitened_steering
from service.inference.results import Source, WindowEstimate, nothing_heard

BAND = (300.0, 3500.0)
"""Hertz: below, small arrays see no delay; above, speech is weak and delays are ambiguous"""
GCC_BAND = (300.0, 6000.0)
"""Hertz for GCC-PHAT: the wider the band, the narrower a correlation's peak, and pairs that are
ambiguous above 3500 Hz are not so at the same delays"""
RELATIVE_HEIGHT = 0.6
"""Least height of a source's peak above the mean, against the highest peak's"""
LEAST_CONTRAST = {"norm_music": 0.32, "music": 0.32, "srp_phat": 0.24, "gcc_phat": 0.5}
"""Least 1 - mean / peak of a spectrum with a direction; white and diffuse noise stay below"""
SPHERE_LEAST_CONTRAST = {"norm_music": 0.42, "music": 0.42, "srp_phat": 0.24, "gcc_phat": 0.5}
"""The same on the sphere, where a mean holds more of what is far from a peak; one window in
twenty of white or diffuse noise is above"""
LEAST_RESPONSE = 0.03
"""Least peak of SRP-PHAT's response, 1 for a plane wave; white noise stays below 0.02"""
LEAST_DEVIATIONS = 7.0
"""Least peak of GCC-PHAT's response in standard deviations of the response to white noise, whose
mean over F bins and P pairs of random phases is 1 / sqrt(2 F P); white noise stays below 6"""

STEERED: Mapping[
    Method, Callable[[ComplexArray, ComplexArray, PairProducts | None], FloatArray]
] = {"srp_phat": classical.srp_phat, "gcc_phat": classical.gcc_phat}
"""Spectra that need no subspace"""


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
    "gcc_phat": Chances(Curve(12.9, 0.52), Curve(6.0, 0.43), 0.19),
}
"""Chances by method, fitted to 1,800 simulated windows (GCC-PHAT's: 600) by
``python -m model_export classical-confidence``"""
SPHERE_CHANCES: Mapping[Method, Chances] = {
    "norm_music": Chances(Curve(7.8, 0.39), Curve(3.8, 0.59), 0.28),
    "music": Chances(Curve(4.0, 0.60), Curve(0.6, 2.0), 0.01),
    "srp_phat": Chances(Curve(7.5, 0.20), Curve(9.5, 0.23), 0.10),
    "gcc_phat": Chances(Curve(19.7, 0.51), Curve(15.0, 0.51), 0.20),
}
"""The same on the sphere, from 480 windows of three arrays with height"""

_shared: WeakValueDictionary[tuple[bytes, bytes, bytes], Grid] = WeakValueDictionary()


def shared_grid(positions: FloatArray, frequencies: FloatArray, directions: FloatArray) -> Grid:
    """The grid of an array (N, 3) in directions (A, 3).

    Users share one instance, which takes megabytes.
    """
    key = (positions.tobytes(), frequencies.tobytes(), directions.tobytes())
    grid = _shared.get(key)
    if grid is None:
        grid = _shared[key] = Grid(direction_steering(positions, frequencies, directions))
    return grid


class ClassicalLocalizer:
    """MUSIC, NormMUSIC, SRP-PHAT or GCC-PHAT on windows of one array's audio.

    The band in hertz is the method's own by default.
    """

    def __init__(
        self,
        method: Method,
        array: MicrophoneArray,
        stft: Stft | None = None,
        noise: NoiseCovariance | None = None,
        hemisphere: Hemisphere = "both",
        *,
        band: tuple[float, float] | None = None,
    ) -> None:
        band = band or (GCC_BAND if method == "gcc_phat" else BAND)
        self._method = method
        self._steered = STEERED.get(method)
        self._stft = stft or Stft()
        frequencies = self._stft.frequencies
        # A slice: an array of bins would copy every window's spectra.
        self._band = slice(
            int(np.searchsorted(frequencies, band[0])),
            int(np.searchsorted(frequencies, band[1], side="right")),
        )
        self._sphere = searched_directions(array, hemisphere)
        """The directions to search; None where azimuths are"""
        directions = self._sphere.vectors if self._sphere else unit_vectors(azimuth_grid())
        self._least_contrast = (SPHERE_LEAST_CONTRAST if self._sphere else LEAST_CONTRAST)[method]
        self._chances = (SPHERE_CHANCES if self._sphere else CHANCES)[method]
        band_frequencies = frequencies[self._band]
        self._grid = shared_grid(array.steered, band_frequencies, directions)
        self._whitening: Whitening | None = None
        if noise is not None:
            self._whitening = Whitening.fitting(noise, array, self._stft).band(self._band)
            self._grid = Grid(self._whitening.steering(self._grid.steering))
        self._steering: Callable[[FloatArray], ComplexArray] = partial(
            whitened_steering, self._whitening, array.steered, band_frequencies
        )
        """Steering vectors (F, N, P) of directions (P, 3)"""
        self._searched = searched_half(array, azimuth_grid())
        self.nothing = nothing_heard(
            NUM_AZIMUTHS if self._sphere else len(self._searched), sphere=self._sphere is not None
        )
        self._most_sources = array.num_microphones - 1
        pairs = self._most_sources * array.num_microphones / 2
        bins = self._band.stop - self._band.start
        self._least_response = {
            "srp_phat": LEAST_RESPONSE,
            "gcc_phat": LEAST_DEVIATIONS / math.sqrt(2 * bins * pairs),
        }.get(method, 0.0)

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
        spectrum, bins = self._scan(covariance, dimension)
        highest = float(spectrum.max())
        scaled = spectrum / np.float32(highest) if highest > 0 else spectrum
        mean = float(scaled.mean())
        directed = 1 - mean >= self._least_contrast and highest >= self._least_response
        level = 0.0
        if num_sources is None:
            level = mean + RELATIVE_HEIGHT * (1 - mean) if directed else math.inf
        curve = self._chances.asked if num_sources else self._chances.counted

        def source(height: float, azimuth: float, elevation: float | None = None) -> Source:
            chance = (
                curve.at(1 - mean / max(height, mean)) if directed else self._chances.undirected
            )
            return Source(azimuth, chance, elevation=elevation)

        most = num_sources or max_sources
        if self._sphere is None:
            peaks = find_peaks(np.where(self._searched, scaled, 0), most)
            found = tuple(source(p.height, p.azimuth) for p in peaks if p.height >= level)
            return WindowEstimate(found, scaled)
        kept = [peak for peak in self._sphere.peaks(scaled, most) if scaled[peak] >= level]
        vertices = [self._sphere.vertex(scaled, peak) for peak in kept]
        towards = self._uphill(vertices, covariance, dimension, bins)
        sources = tuple(
            source(float(scaled[peak]), *azimuth_elevation(direction))
            for peak, direction in zip(kept, towards, strict=True)
        )
        image = self._sphere.image(scaled)
        return WindowEstimate(sources, self._sphere.azimuth_spectrum(scaled), image)

    def spectrum(self, covariance: ComplexArray, num_sources: int) -> FloatArray:
        """Broadband spectrum (A,) from the output of ``covariance``, in the searched directions."""
        return self._scan(covariance, num_sources)[0]

    def _scan(
        self, covariance: ComplexArray, num_sources: int
    ) -> tuple[FloatArray, FloatArray | None]:
        """The spectrum, and for NormMUSIC each bin's maximum (F,)."""
        steering, products = self._grid.steering, self._grid.products
        if self._steered is not None:
            return np.maximum(self._steered(covariance, steering, products), 0), None
        bins = classical.music_of_bins(covariance, steering, num_sources, products)
        if self._method == "music":
            return mean_fusion(bins), None
        return normalised_fusion(bins), bins.max(axis=-1)

    def _uphill(
        self,
        vertices: Sequence[FloatArray],
        covariance: ComplexArray,
        num_sources: int,
        highest: FloatArray | None,
    ) -> list[FloatArray]:
        """The spectrum's maxima next to unit vectors (3,), without a grid.

        ``highest`` are the bins' maxima on the grid.
        """
        if not vertices:
            return []
        steered = self._steered
        subspace = signal_subspace(covariance, num_sources) if steered is None else covariance

        def values(directions: FloatArray) -> FloatArray:
            steering = self._steering(directions)
            if steered is not None:
                return np.maximum(steered(covariance, steering, None), 0)
            bins = music_spectrum(subspace, steering)
            if highest is not None:
                bins /= np.maximum(highest, bins.max(axis=-1))[:, None]
            return mean_fusion(bins)

        return [climbed(vertex, values) for vertex in vertices]
