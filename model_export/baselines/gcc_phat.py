"""GCC-PHAT: time differences of microphone pairs, added up to a spectrum over azimuth.

Per pair the cross-spectrum is averaged over frames, whitened to unit magnitude and transformed
back; the correlation at an azimuth's delay is the pair's vote for that azimuth. Only delays up to
distance / c are used, hence no periodic image of the correlation.

SRP-PHAT whitens every frame; this method averages first, as Knapp and Carter define it. Frames
thus count by their power, and a pause between words adds no noise to the phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from model_export.baselines.method import Card, Estimate
from model_export.baselines.told import STFT, ToldMethod, band_bins, searched_peaks
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.classical import phase_transform
from service.doa.covariance import sample_covariance
from service.doa.mirror import searched_half
from service.doa.steering import azimuth_grid, unit_vectors
from service.doa.types import BoolArray, ComplexArray, FloatArray, IntArray

CARD = Card(
    "gcc_phat",
    "GCC-PHAT",
    "classical",
    "Knapp, Carter, 1976, The generalized correlation method for estimation of time delay, "
    "table I (PHAT)",
    "the pairs' correlations at every azimuth's delays, summed; 300-6000 Hz",
)
BAND = (300.0, 6000.0)
"""Hertz; wider than for the other methods, since a wider band makes a correlation's peak narrower,
and one pair's aliasing at a wrong delay is not shared by the others. Speech is weak above."""
INTERPOLATION = 16
"""Lags per sample, 4 microseconds or 1.3 mm of path each; linear interpolation does between them"""


@dataclass(frozen=True, slots=True)
class Pairs:
    """An array's P pairs and the lags of all azimuths A in their correlations."""

    first: IntArray
    """(P,) first microphones"""
    second: IntArray
    """(P,) second microphones"""
    lag: FloatArray
    """(P, A) delays of the azimuths in interpolated lags, of either sign"""
    searched: BoolArray
    """(A,) azimuths that are searched"""


class GccPhat(ToldMethod[Pairs]):
    """GCC-PHAT on all pairs of any array."""

    card = CARD

    def prepare(self, array: MicrophoneArray) -> Pairs:
        first, second = np.triu_indices(array.num_microphones, 1)
        azimuth = azimuth_grid()
        apart = array.positions[first] - array.positions[second]
        # The microphone nearer to the source hears it earlier: its signal leads.
        lead = apart @ unit_vectors(azimuth).T / SPEED_OF_SOUND  # (P, A) seconds
        lag = -lead * (STFT.sample_rate * INTERPOLATION)
        return Pairs(first, second, lag, searched_half(array, azimuth))

    def estimate(self, audio: FloatArray, prepared: Pairs, num_sources: int) -> Estimate:
        """The highest maxima of the summed correlations ``spectrum`` (360,)."""
        covariance = sample_covariance(STFT.transform(audio))  # (F, N, N)
        cross = covariance[:, prepared.first, prepared.second].T  # (P, F) of x_i conj(x_j)
        correlation = phat_correlation(cross)
        spectrum = value_at(correlation, prepared.lag).sum(axis=0)
        return searched_peaks(spectrum, prepared.searched, num_sources)


def phat_correlation(cross: ComplexArray) -> FloatArray:
    """Generalized cross-correlation with the phase transform.

    Parameters
    ----------
    cross : (P, F) complex64
        Cross-spectra on all bins of ``STFT``; those outside ``BAND`` are left out.

    Returns
    -------
    correlation : (P, n_fft * INTERPOLATION) float32
        Values at lags of 1 / (16000 * INTERPOLATION) seconds, negative lags counted from the end;
        1 where all phases agree.
    """
    bins = band_bins(BAND)
    whitened = np.zeros_like(cross)
    whitened[:, bins] = phase_transform(cross[:, bins])
    length = STFT.n_fft * INTERPOLATION
    correlation: FloatArray = scipy.fft.irfft(whitened, n=length, axis=-1)
    return correlation * np.float32(length / (2 * len(bins)))


def value_at(correlation: FloatArray, lag: FloatArray) -> FloatArray:
    """Linear interpolation (P, A) of correlations (P, L) at fractional circular lags (P, A)."""
    below = np.floor(lag).astype(np.int64)
    share = lag - below
    length = correlation.shape[-1]
    low = np.take_along_axis(correlation, below % length, axis=-1)
    high = np.take_along_axis(correlation, (below + 1) % length, axis=-1)
    value: FloatArray = (1 - share) * low + share * high
    return value
