"""TOPS, the test of orthogonality of projected subspaces, through pyroomacoustics.

The signal subspace of the loudest bin, moved to every other bin's frequency for an assumed azimuth,
is orthogonal to that bin's noise subspace where a source is. No focusing angles are needed.

The library (0.10) uses the steering of bin k of the spectrum for bin k of the band, which is right
only if the band starts with the spectrum. TOPS depends on differences of frequency only, so the
band is moved there and all indices agree. The library also tests the loudest bin against itself,
which adds zeros, and leaves out the last bin, one in a hundred.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from model_export.baselines.method import Card, Estimate
from model_export.baselines.pyroom import direction_finder, quiet
from model_export.baselines.told import STFT, ToldMethod, band_bins, searched_peaks
from service.doa.array import MicrophoneArray
from service.doa.mirror import searched_half
from service.doa.steering import azimuth_grid
from service.doa.types import BoolArray, FloatArray

CARD = Card(
    "tops",
    "TOPS",
    "classical",
    "Yoon, Kaplan, McClellan, 2006, TOPS: new DOA estimator for wideband signals; pyroomacoustics",
    "500-4000 Hz, the band moved so that the library's bins agree, circular peaks",
)
BAND = (500.0, 4000.0)
"""Hertz; higher than for the other methods, since TOPS relies on the noise subspaces of many bins,
and the lowest bins, at which all directions look alike, carry no information"""


class Tops(ToldMethod[tuple[Any, BoolArray]]):
    """TOPS on any array of two microphones and more."""

    card = CARD

    def prepare(self, array: MicrophoneArray) -> tuple[Any, BoolArray]:
        return direction_finder("TOPS", array), searched_half(array, azimuth_grid())

    def estimate(
        self, audio: FloatArray, prepared: tuple[Any, BoolArray], num_sources: int
    ) -> Estimate:
        """The highest maxima of the inverse smallest singular value ``spectrum`` (360,)."""
        finder, searched = prepared
        spectra = STFT.transform(audio)
        bins = band_bins(BAND)
        moved = np.zeros_like(spectra)
        moved[:, : len(bins)] = spectra[:, bins]
        with quiet():
            finder.locate_sources(
                moved, num_src=min(num_sources, len(audio) - 1), freq_bins=np.arange(len(bins))
            )
        return searched_peaks(finder.grid.values, searched, num_sources)
