"""FRIDA, directions from an annihilating filter without a grid, through pyroomacoustics.

The cross-correlations of all pairs are linear in the Fourier coefficients of the intensity over
azimuth; those of K sources satisfy a filter of K + 1 taps whose roots are the directions.

Three things are left to the caller. The coefficients, 2 max_four + 1 real numbers, have to be fewer
than what the pairs tell: parallel and equal pairs of a square or ring tell the same, which the
library's own check does not see. The filter starts from numpy's global random numbers. The mapping
of a finder's first window stays with it although other bins have another one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from model_export.baselines.method import Card, Estimate
from model_export.baselines.pyroom import direction_finder, quiet
from model_export.baselines.told import STFT, ToldMethod, band_bins
from service.doa.array import MIN_SPACING, SPEED_OF_SOUND, MicrophoneArray
from service.doa.types import ComplexArray, FloatArray, IntArray

CARD = Card(
    "frida",
    "FRIDA",
    "classical",
    "Pan, Scheibler, Bezzam, Dokmanic, Vetterli, 2017, FRIDA: FRI-based DOA estimation for "
    "arbitrary array layouts; pyroomacoustics",
    "the 20 loudest bins of 1000-4000 Hz, a fixed start, coefficients as many as the pairs tell",
)
BAND = (1000.0, 4000.0)
"""Hertz; below it the small array's coefficients of order 2 and more drown in the noise"""
NUM_BINS = 20
MOST_FOURIER = 6
"""Highest order of the coefficients, of arrays of some decimetres"""
FAILURES = (np.linalg.LinAlgError, ValueError, UnboundLocalError, RuntimeError)
"""What the library raises where no start leads anywhere: singular systems, roots that are not
finite (a sound from above, which has no azimuth), results never set, amplitudes not converging"""


@dataclass(frozen=True, slots=True)
class Orders:
    """Which orders of the Fourier coefficients an array tells."""

    array: MicrophoneArray
    heard: int
    """Above it they are nearly zero: J_m(k r) of m > k r, r being half the aperture"""
    most: int
    """Above it there are more coefficients than different pairs"""


class Frida(ToldMethod[Orders]):
    """FRIDA on arrays in a plane; heights are left out.

    ``failures`` counts the windows without an answer because the library found none.
    """

    card = CARD

    def __init__(self) -> None:
        super().__init__()
        self.failures = 0

    def prepare(self, array: MicrophoneArray) -> Orders:
        if array.linear:
            raise ValueError(
                f"FRIDA cannot be used with the line {array.name!r}, which cannot tell the sides "
                "apart: it needs microphones in a plane"
            )
        heard = int(np.ceil(2 * np.pi * BAND[1] * array.aperture / 2 / SPEED_OF_SOUND))
        # A pair tells a complex number.
        most = (2 * distinct_baselines(array) - 1) // 2
        return Orders(array, min(heard, MOST_FOURIER), most)

    def estimate(self, audio: FloatArray, prepared: Orders, num_sources: int) -> Estimate:
        """Directions by falling mean amplitude; no ``spectrum``."""
        array, most = prepared.array, prepared.most
        if num_sources > most:
            raise ValueError(
                f"FRIDA finds at most {most} sources with array {array.name!r}, not "
                f"{num_sources}: more need more microphones"
            )
        max_four = min(max(prepared.heard, num_sources), most)
        spectra = STFT.transform(audio)
        finder = direction_finder("FRIDA", array, num_src=num_sources, max_four=max_four)
        try:
            with quiet(), fixed_random_numbers():
                finder.locate_sources(
                    spectra, num_src=num_sources, freq_bins=loudest_bins(spectra, NUM_BINS)
                )
        except FAILURES:
            self.failures += 1
            return Estimate(np.empty(0))
        amplitude = np.abs(finder.alpha_recon).mean(axis=-1)  # (M,)
        return Estimate(np.atleast_1d(finder.azimuth_recon)[np.argsort(-amplitude)])


def loudest_bins(spectra: ComplexArray, count: int) -> IntArray:
    """The ``count`` bins of ``BAND`` with the most power in spectra (N, F, L), in order."""
    bins = band_bins(BAND)
    power = np.square(np.abs(spectra[:, bins])).sum(axis=(0, 2))
    loudest: IntArray = np.sort(bins[np.argsort(-power)[:count]])
    return loudest


def distinct_baselines(array: MicrophoneArray) -> int:
    """How many different horizontal vectors, but for the sign, join two microphones."""
    first, second = np.triu_indices(array.num_microphones, 1)
    baselines = np.rint((array.positions[first] - array.positions[second])[:, :2] / MIN_SPACING)
    turned = baselines[:, 0] < 0
    turned |= (baselines[:, 0] == 0) & (baselines[:, 1] < 0)
    baselines[turned] *= -1
    return len(np.unique(baselines[baselines.any(axis=1)], axis=0))


@contextmanager
def fixed_random_numbers() -> Iterator[None]:
    """numpy's global random numbers from a fixed seed, afterwards as if none had been drawn."""
    state = np.random.get_state()  # noqa: NPY002  the library draws from no other
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
