"""The array's size from reverberation; plane waves cannot show that the given size is too large.

A smaller array hears smaller delays, and so does an array of the right size from talkers above it.
Decaying sound comes from everywhere: there two microphones at a distance d have the coherence
sin(k d) / (k d) with k = 2 pi f / c, wherever the talker is (Cook et al., 1955; for calibration
McCowan, Lincoln, Himawan, 2008). Noises of the microphones lower it by a factor common to all
pairs, so only its shape over frequency and distance counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.array import (
    MIN_SPACING,
    SPEED_OF_SOUND,
    MicrophoneArray,
    pairwise_distances,
)
from service.doa.diagnostics.finding import Finding
from service.doa.stft import Stft
from service.doa.types import BoolArray, ComplexArray, FloatArray

FRAME_S = 0.032
BAND = (600.0, 4500.0)  # Hz
FALL = 0.5  # of the power two frames before: the sound has ended, its reflections have not
QUIET = 0.2
"""Share of a bin's frames, the quietest, that hold the steady background"""
ABOVE_QUIET = 4.0
"""Least power of decaying sound against the loudest of the quiet frames"""
COHERENT_BAND = (3000.0, 4500.0)  # Hz
COHERENT = 0.08
"""Largest mean coherence of the background in that band: a fan under the array, or a signal that
couples into all channels, would make the array look small"""
MIN_CELLS = 1500
SCALES = np.arange(0.4, 1.6, 0.02)
SMALLER = 0.86
"""Largest estimate that is a finding. Reflections come from the walls more than from the ceiling,
which makes estimates for correct arrays 1.0 to 1.3; only people who are always 60 degrees above the
array in a dry room (RT60 0.2 s) bring them down to 0.8"""
MIN_GAIN = 1.15
"""Least gain of a finding; below it the given size explains the coherence nearly as well"""
MAX_RESIDUAL = 0.4
"""Largest share of the coherence's power that the best scale leaves; one direction leaves more"""
MIN_APERTURE, MAX_APERTURE = 0.03, 0.3  # m; smaller arrays are coherent in the band, larger never


@dataclass(frozen=True, slots=True)
class DiffuseFit:
    """The array size whose diffuse coherence matches the recording."""

    scale: float
    """Size against the given one"""
    gain: float
    """Misfit of the given size over the misfit of this one, at least 1"""


def diffuse_fit(
    segments: Sequence[FloatArray], sample_rate: int, positions: FloatArray
) -> DiffuseFit | None:
    """The size of the array against ``positions``, or None where too little reverberation is heard.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.
    positions : (N, 3) float
        Metres.
    """
    n_fft = 1 << round(np.log2(FRAME_S * sample_rate))
    stft = Stft(sample_rate, n_fft, n_fft // 2)
    usable = [segment for segment in segments if segment.shape[-1] >= stft.num_samples(3)]
    if not usable:
        return None
    band = (stft.frequencies >= BAND[0]) & (stft.frequencies <= BAND[1])
    spectra = np.stack([stft.transform(s)[:, band] for s in usable if s.shape == usable[0].shape])
    power = np.mean(spectra.real**2 + spectra.imag**2, axis=1)  # (S, F, L)
    level = np.quantile(power, QUIET, axis=(0, 2), keepdims=True)
    frequencies = stft.frequencies[band]
    steady = _coherence(spectra, power, power <= level)
    high = (frequencies >= COHERENT_BAND[0]) & (frequencies <= COHERENT_BAND[1])
    pairs = np.triu_indices(len(positions), 1)
    if float(steady[high][:, pairs[0], pairs[1]].mean()) > COHERENT:
        return None
    dying = power > ABOVE_QUIET * level
    dying[..., :2] = False
    dying[..., 2:] &= power[..., 2:] < FALL * power[..., :-2]
    if np.count_nonzero(dying) < MIN_CELLS:
        return None
    coherence = _coherence(spectra, power, dying)
    return _fitted(coherence, frequencies, pairwise_distances(positions))


def _coherence(spectra: ComplexArray, power: FloatArray, cells: BoolArray) -> FloatArray:
    """Real part of the coherence (F, N, N) over chosen cells (S, F, L) of spectra (S, N, F, L)."""
    scaled = spectra * (cells / np.sqrt(np.maximum(power, np.finfo(np.float32).tiny)))[:, None]
    by_bin = np.moveaxis(scaled, 2, 0).swapaxes(1, 2)  # (F, N, S, L)
    by_bin = by_bin.reshape(*by_bin.shape[:2], -1)
    cross = by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
    own = np.sqrt(np.maximum(np.einsum("fnn->fn", cross).real, 1e-12))
    coherence: FloatArray = (cross / (own[:, :, None] * own[:, None])).real
    return coherence


def _fitted(
    coherence: FloatArray, frequencies: FloatArray, distances: FloatArray
) -> DiffuseFit | None:
    """The scale whose diffuse coherence fits (F, N, N) best, or None where none does."""
    pairs = np.triu_indices(len(distances), 1)
    measured = coherence[:, pairs[0], pairs[1]]  # (F, P)
    residuals = []
    for scale in SCALES:
        expected = np.sinc(2 * frequencies[:, None] * scale * distances[pairs] / SPEED_OF_SOUND)
        share = np.sum(measured * expected, axis=1) / np.sum(expected**2, axis=1)
        rest = measured - np.clip(share, 0, 1)[:, None] * expected
        residuals.append(float(np.sum(rest**2)))
    best = int(np.argmin(residuals))
    if best == 0:  # still falling at the smallest scale: sound from nearby rather than diffuse
        return None
    if residuals[best] > MAX_RESIDUAL * float(np.sum(measured**2)):
        return None
    given = residuals[int(np.argmin(np.abs(SCALES - 1)))]
    return DiffuseFit(float(SCALES[best]), given / max(residuals[best], 1e-12))


def size_findings(
    segments: Sequence[FloatArray], sample_rate: int, array: MicrophoneArray
) -> list[Finding]:
    """``array_scale`` where the array is clearly smaller than given."""
    if not MIN_APERTURE <= array.aperture <= MAX_APERTURE or _upright(array):
        return []
    fit = diffuse_fit(segments, sample_rate, array.positions)
    if fit is None or fit.scale > SMALLER or fit.gain < MIN_GAIN:
        return []
    detail = (
        f"the reverberation fits an array about {fit.scale:.1f} times as large as the given one: "
        f"check the positions (a diameter is twice a radius, a side of a square is not its "
        f"diagonal); in a very dry room, an array that hears everybody from steeply above sounds "
        f"the same"
    )
    return [Finding("array_scale", detail)]


def _upright(array: MicrophoneArray) -> bool:
    """Whether the array is a panel in a vertical plane, which looks too large between walls that
    reflect more than floor and ceiling."""
    return array.linear and bool(np.ptp(array.positions[:, 2]) > MIN_SPACING)
