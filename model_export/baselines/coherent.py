"""CSSM and WAVES, coherent subspaces by focusing, through pyroomacoustics.

Both focus every bin's spatial statistics on one reference bin: focusing matrices map the steering
vectors of preliminary directions from each frequency to the reference's. There the statistics are
averaged into a MUSIC spectrum, whose peaks are the next iteration's directions. CSSM averages
covariances, WAVES joins weighted signal subspaces.

Two defects of the library (0.10) are corrected. Its focusing matrices are exactly singular where
two directions mirror each other about the line through the first two microphones, which raises
``LinAlgError`` in a tenth of the windows with two talkers; ours are unitary and always exist (Hung
and Kaveh, 1988, Focussing matrices for coherent signal-subspace processing). It also drops bins
whose beamformer has fewer peaks than sources but keeps their covariances, so that bins and
statistics do not match; here only bins with enough peaks are passed to it. If there is no such
bin, one direction less is sought.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pyroomacoustics.doa import CSSM, WAVES

from model_export.baselines.method import Card, Estimate
from model_export.baselines.pyroom import build, quiet
from model_export.baselines.told import STFT, ToldMethod, band_bins, searched_peaks
from service.doa.array import MicrophoneArray
from service.doa.covariance import sample_covariance
from service.doa.mirror import searched_half
from service.doa.steering import azimuth_grid
from service.doa.types import BoolArray, ComplexArray, FloatArray, IntArray

CSSM_CARD = Card(
    "cssm",
    "CSSM",
    "classical",
    "Wang, Kaveh, 1985, Coherent signal-subspace processing for the detection and estimation of "
    "angles of arrival of multiple wide-band sources; pyroomacoustics",
    "1000-3500 Hz, unitary focusing, bins with preliminary peaks only, circular peaks",
)
WAVES_CARD = Card(
    "waves",
    "WAVES",
    "classical",
    "di Claudio, Parisi, 2001, WAVES: weighted average of signal subspaces for robust wideband "
    "direction finding; pyroomacoustics",
    "as CSSM; weights that do not change with the recording's level",
)
BAND = (1000.0, 3500.0)
"""Hertz; the spectrum is that of the loudest bin, at which a small array must resolve directions;
at 300 Hz, a voice's first harmonics, it does not"""
IDENTITY = 0.01
"""Weight of the identity relative to the directions in a focusing matrix. It determines the
dimensions that no direction spans; 0.3 would bias a 12 cm line's directions by 2 degrees or more"""
TINY = np.finfo(np.float64).tiny


class _Focusing:
    """Methods that override parts of the library's two classes, under their names."""

    freq_bins: IntArray
    grid: Any
    steering: ComplexArray
    """(F, N, A) complex128 of all bins; single precision gives flat beamformers false peaks"""

    def separating(self, spectra: ComplexArray, bins: IntArray, count: int) -> IntArray:
        """Select the bins whose beamformer has ``count`` peaks, as the library counts them."""
        covariance = sample_covariance(spectra[:, bins])
        kept = []
        for matrix, place in zip(covariance, bins, strict=True):
            self.grid.set_values(1 / self._compute_spatial_spectrum(matrix, int(place)))
            kept.append(len(self.grid.find_peaks(k=count)) >= count)
        return bins[kept]

    def _compute_correlation_matrices(self, spectra: ComplexArray) -> ComplexArray:
        return sample_covariance(spectra[:, self.freq_bins])

    def _compute_spatial_spectrum(self, matrix: ComplexArray, place: int) -> FloatArray:
        """1 / |a^H R a| (A,), like the library's but without a loop over azimuths."""
        steering = self.steering[place]
        power = np.abs(np.sum(steering.conj() * (matrix @ steering), axis=0))
        spectrum: FloatArray = 1 / np.maximum(power, TINY)
        return spectrum

    def focusing(self, reference: int, directions: Any) -> ComplexArray:
        """Unitary T (F, N, N) nearest to T a_k = a_0 for directions (F, K), grid indices.

        It minimises the squared error of the directions plus IDENTITY times the squared error to I.
        """
        chosen = np.asarray(directions)[:, None, :]  # (F, 1, K)
        source = np.take_along_axis(self.steering[self.freq_bins], chosen, axis=-1)
        target = np.take_along_axis(self.steering[reference][None], chosen, axis=-1)
        product = target @ np.conj(np.swapaxes(source, -1, -2))
        left, _, right = np.linalg.svd(product + IDENTITY * np.eye(product.shape[-1]))
        matrices: ComplexArray = left @ right
        return matrices


class _Cssm(_Focusing, CSSM):  # type: ignore[misc]
    def _coherent_sum(
        self, covariance: ComplexArray, reference: int, directions: Any
    ) -> ComplexArray:
        focusing = self.focusing(reference, directions)
        total: ComplexArray = (focusing @ covariance @ np.conj(np.swapaxes(focusing, -1, -2))).sum(
            axis=0
        )
        return total


class _Waves(_Focusing, WAVES):  # type: ignore[misc]
    def _construct_waves_matrix(
        self, covariance: ComplexArray, reference: int, directions: Any
    ) -> None:
        """Columns of all bins' signal subspaces, focused and weighted: ``Z`` (N, F K).

        The weights are (l - s) / sqrt(l s) for eigenvalues l and the noise's s. The library adds 1
        under the root, which makes them depend on the recording's level.
        """
        values, vectors = np.linalg.eigh(covariance.astype(np.complex128))
        signal, noise = values[:, -self.num_src :], values[:, [-self.num_src - 1]]
        noise = np.maximum(noise, TINY**0.5)
        weights = (signal - noise) / np.sqrt(np.maximum(signal, noise) * noise)
        focused = self.focusing(reference, directions) @ vectors[..., -self.num_src :]
        self.Z = np.concatenate(list(focused * weights[:, None]), axis=-1)


class _Coherent(ToldMethod[tuple[Any, BoolArray]]):
    """A coherent method; ``failures`` counts the windows in which no bin has enough peaks."""

    finder: Any

    def __init__(self) -> None:
        super().__init__()
        self.failures = 0

    def prepare(self, array: MicrophoneArray) -> tuple[Any, BoolArray]:
        finder = build(self.finder, array)
        finder.steering = finder.mode_vec[np.arange(STFT.num_bins), :, :]
        return finder, searched_half(array, azimuth_grid())

    def estimate(
        self, audio: FloatArray, prepared: tuple[Any, BoolArray], num_sources: int
    ) -> Estimate:
        """The highest maxima of the reference bin's MUSIC ``spectrum`` (360,)."""
        finder, searched = prepared
        spectra = STFT.transform(audio)
        most = min(num_sources, len(audio) - 1)
        for count in range(most, 0, -1):
            bins = finder.separating(spectra, band_bins(BAND), count)
            if len(bins):
                with quiet():
                    finder.locate_sources(spectra, num_src=count, freq_bins=bins)
                self.failures += count < most
                return searched_peaks(finder.grid.values, searched, num_sources)
        self.failures += 1
        return Estimate(np.empty(0))


class Cssm(_Coherent):
    """The coherent signal-subspace method on any array."""

    card = CSSM_CARD
    finder = _Cssm


class Waves(_Coherent):
    """The weighted average of signal subspaces on any array."""

    card = WAVES_CARD
    finder = _Waves
