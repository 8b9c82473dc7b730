"""Root-MUSIC: roots of the MUSIC denominator, a polynomial on a uniform linear array.

On N microphones at distances d along a line, a source at angle phi to the line's axis has the
steering vector 1, z, z^2, ... with z = exp(j 2 pi f d cos(phi) / c), so a^H Un Un^H a is a
polynomial in z whose coefficients are the sums of the diagonals of Un Un^H. Its roots come in pairs
mirrored at the unit circle; the inner roots nearest to it are the sources'. No grid is searched.

Broadband, the directions of every bin vote for azimuths as narrow Gaussians; the maxima of the
votes are the estimates, refined to the votes' centre of gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model_export.baselines.method import Card, Estimate
from model_export.baselines.told import (
    SPEECH_BAND,
    STFT,
    ToldMethod,
    band_bins,
    searched_peaks,
)
from service.doa.array import MIN_SPACING, SPEED_OF_SOUND, MicrophoneArray
from service.doa.covariance import sample_covariance
from service.doa.evd import noise_projector, signal_subspace
from service.doa.mirror import into_searched_half, searched_half
from service.doa.scoring import circular_error
from service.doa.steering import azimuth_grid
from service.doa.types import BoolArray, ComplexArray, FloatArray, IntArray

CARD = Card(
    "root_music",
    "Root-MUSIC",
    "classical",
    "Barabell, 1983, Improving the resolution performance of eigenstructure-based "
    "direction-finding algorithms",
    "broadband by a vote of the bins from 300 Hz to 3500 Hz or to the line's spatial aliasing",
    linear_only=True,
)
VOTE_WIDTH = float(np.deg2rad(3.0))
"""Standard deviation of a vote in radians"""
CLOSENESS = 0.1
"""Distance to the unit circle at which a root's vote counts half"""
LEAST_VOTE = 1e-6
"""Floor of the votes relative to the highest"""
BEYOND = 1.1
"""Largest |cos phi| that noise can give a direction along the line; roots beyond are no sources"""


@dataclass(frozen=True, slots=True)
class Line:
    """A uniform line of microphones."""

    array: MicrophoneArray
    order: IntArray
    """(N,) microphones along the axis"""
    spacing: float
    """Metres between neighbours, as seen from the horizontal plane"""
    axis: float
    """Azimuth of the axis in radians"""
    bins: IntArray
    """(F,) bins below spatial aliasing"""
    searched: BoolArray
    """(A,) azimuths that are searched"""


class RootMusic(ToldMethod[Line]):
    """Root-MUSIC on uniform linear arrays; it reports directions in the searched half."""

    card = CARD

    def prepare(self, array: MicrophoneArray) -> Line:
        return uniform_line(array)

    def estimate(self, audio: FloatArray, prepared: Line, num_sources: int) -> Estimate:
        """Directions in order of falling votes; ``spectrum`` (360,) holds the votes."""
        line = prepared
        spectra = STFT.transform(audio)[line.order][:, line.bins]
        dimension = min(num_sources, len(audio) - 1)
        subspace = signal_subspace(sample_covariance(spectra).astype(np.complex128), dimension)
        roots = signal_roots(noise_projector(subspace), dimension)  # (F, M)
        omega = 2 * np.pi * STFT.frequencies[line.bins, None]
        cosine = np.angle(roots) * SPEED_OF_SOUND / (omega * line.spacing)
        # Noise moves a root's phase equally at all frequencies, hence its cosine by 1 / f: least
        # squares weights are f squared.
        weight = (omega / omega.max()) ** 2 / (1 + np.abs(1 - np.abs(roots)) / CLOSENESS)
        heard = np.abs(cosine) <= BEYOND
        angle = line.axis + np.arccos(np.clip(cosine[heard], -1, 1))
        azimuth = into_searched_half(line.array, angle)
        return _vote(azimuth, weight[heard], line, num_sources)


def uniform_line(array: MicrophoneArray) -> Line:
    """The array as a uniform line; ValueError says what such a line is."""
    centred = array.positions - array.positions.mean(axis=0)
    direction = np.linalg.svd(centred)[2][0]
    along = centred @ direction
    order = np.argsort(along)
    spacings = np.diff(along[order])
    horizontal = float(np.hypot(direction[0], direction[1]))
    spacing = float(spacings.mean()) * horizontal
    # Beyond this deviation the ideal steering vector does not describe the array.
    uniform = np.ptp(spacings) <= max(MIN_SPACING, 0.01 * spacings.mean())
    straight = np.abs(centred - along[:, None] * direction).max() < MIN_SPACING
    if not straight or not uniform:
        raise ValueError(
            f"Root-MUSIC cannot be used with array {array.name!r}: it needs microphones at equal "
            "distances on one line, such as x = 0, 0.04, 0.08 and 0.12 m"
        )
    top = min(SPEED_OF_SOUND / (2 * spacing), SPEECH_BAND[1])
    searched = searched_half(array, azimuth_grid())
    axis = float(np.arctan2(direction[1], direction[0]))
    return Line(array, order, spacing, axis, band_bins((SPEECH_BAND[0], top)), searched)


def signal_roots(projector: ComplexArray, num_sources: int) -> ComplexArray:
    """Roots inside the unit circle nearest to it.

    Parameters
    ----------
    projector : (F, N, N) complex128
        Projectors Un Un^H onto the noise subspaces, microphones in their order along the line.
        num_sources : int
            M, below N.

    Returns
    -------
    roots : (F, M) complex128
        Roots, the nearest to the circle first; exp(j 2 pi f d cos(phi) / c) for noiseless sources.
    """
    microphones = projector.shape[-1]
    offsets = range(microphones - 1, -microphones, -1)
    # The coefficient of z^k is the sum of the k-th diagonal; the highest power first.
    coefficients = np.stack(
        [np.trace(projector, offset=k, axis1=-2, axis2=-1) for k in offsets], axis=-1
    )
    roots = polynomial_roots(coefficients)
    # Sorted by modulus, not tested for being inside: on the circle a pair coincides, and rounding
    # may push both roots out.
    by_modulus = np.take_along_axis(roots, np.argsort(np.abs(roots), axis=-1), axis=-1)
    nearest: ComplexArray = by_modulus[:, microphones - 2 :: -1][:, :num_sources]
    return nearest


def polynomial_roots(coefficients: ComplexArray) -> ComplexArray:
    """Roots (F, D) of polynomials (F, D + 1), highest power first, as eigenvalues.

    A leading coefficient of zero, whose root is infinite, is replaced by the least significant one.
    """
    degree = coefficients.shape[-1] - 1
    scale = np.abs(coefficients).max(axis=-1)
    least = np.maximum(scale, 1) * np.finfo(np.float64).eps
    first = coefficients[:, 0]
    leading = np.where(np.abs(first) < least, least, first)
    companion = np.zeros((len(coefficients), degree, degree), dtype=np.complex128)
    companion[:, 0] = -coefficients[:, 1:] / leading[:, None]
    companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def _vote(azimuth: FloatArray, weight: FloatArray, line: Line, num_sources: int) -> Estimate:
    """Estimate of the azimuths with most votes, which have azimuths and weights (V,)."""
    distance = circular_error(azimuth_grid()[:, None], azimuth)  # (A, V)
    votes = np.exp(-0.5 * np.square(distance / VOTE_WIDTH)) @ weight
    # The peaks' parabola uses reciprocals, which would overflow for votes near zero.
    votes = np.maximum(votes, LEAST_VOTE * votes.max())
    peaks = searched_peaks(votes, line.searched, num_sources)
    return Estimate(_centres(peaks.azimuth, azimuth, weight), votes)


def _centres(peaks: FloatArray, azimuth: FloatArray, weight: FloatArray) -> FloatArray:
    """Peaks (M,) moved to the weighted mean direction of the votes around them."""
    near = np.exp(-0.5 * np.square(circular_error(peaks[:, None], azimuth) / VOTE_WIDTH)) * weight
    centre: FloatArray = np.angle(near @ np.exp(1j * azimuth)) % (2 * np.pi)
    return centre
