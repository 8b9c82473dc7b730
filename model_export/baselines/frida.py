"""FRIDA, gridless directions from an annihilating filter, through pyroomacoustics.

The cross-correlations of all pairs are linear in the Fourier coefficients of the intensity over
azimuth. The coefficients of K sources are annihilated by a filter of K + 1 taps, whose roots are
the directions.

Three things are left to the caller. The coefficients, 2 max_four + 1 real numbers, must be fewer
than the numbers that the pairs measure: equal and parallel pairs of a square or ring measure the
same, which the library does not check. The filter starts from numpy's global random numbers. A
finder keeps the mapping of its first window, which is wrong for other bins.
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
    "the 20 loudest bins of 1000-4000 Hz, a fixed start, as many coefficients as the pairs allow",
)
BAND = (1000.0, 4000.0)
"""Hertz; below it the noise masks a small array's coefficients of order 2 and higher"""
NUM_BINS = 20
MOST_FOURIER = 6
"""Cap on the order of the coefficients, for arrays of some decimetres"""
FAILURES = (np.linalg.LinAlgError, ValueError, UnboundLocalError, RuntimeError)
"""Errors that the library raises if no start succeeds: singular systems, roots that are not finite
(a sound from above, which has no azimuth), results never set, amplitudes not converging"""


@dataclass(frozen=True, slots=True)
class Orders:
    """Orders of the Fourier coefficients that an array can measure."""

    array: MicrophoneArray
    heard: int
    """Highest order that is not nearly zero: J_m(k r) vanishes for m > k r, r half the aperture"""
    most: int
    """Highest order with no more coefficients than distinct pairs measure"""


class Frida(ToldMethod[Orders]):
    """FRIDA on planar arrays; heights are ignored.

    ``failures`` counts the windows for which the library finds no answer.
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
        # A pair measures a complex number.
        most = (2 * distinct_baselines(array) - 1) // 2
        return Orders(array, min(heard, MOST_FOURIER), most)

    def estimate(self, audio: FloatArray, prepared: Orders, num_sources: int) -> Estimate:
        """Directions in order of falling mean amplitude; no ``spectrum``."""
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
    """Number of distinct horizontal vectors, up to sign, between two microphones."""
    first, second = np.triu_indices(array.num_microphones, 1)
    baselines = np.rint((array.positions[first] - array.positions[second])[:, :2] / MIN_SPACING)
    turned = baselines[:, 0] < 0
    turned |= (baselines[:, 0] == 0) & (baselines[:, 1] < 0)
    baselines[turned] *= -1
    return len(np.unique(baselines[baselines.any(axis=1)], axis=0))


@contextmanager
def fixed_random_numbers() -> Iterator[None]:
    """Seed numpy's global random numbers, and restore their state afterwards."""
    state = np.random.get_state()  # noqa: NPY002  the library draws from no other
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
