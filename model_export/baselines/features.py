"""Input features of the published networks: mel levels and correlations.

All take spectra (..., N, L, F) of N microphones, L frames and F = n_fft / 2 + 1 bins, with any axes
before these. Pairs are those of ``pairs``. A correlation at lag d is high if the pair's first
microphone is d samples later than its second.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from model_export import SAMPLE_RATE
from service.doa.features import LEVEL_FLOOR
from service.doa.stft import hann
from service.doa.types import ComplexArray, FloatArray, IntArray

_TINY = np.finfo(np.float32).tiny


def framed_spectra(audio: FloatArray, window: int, hop: int, n_fft: int) -> ComplexArray:
    """Spectra (..., L, F) complex64 of Hann windows of audio (..., T), zero-padded to ``n_fft``.

    Unlike in ``service.doa.stft.Stft``, the window may be shorter than ``n_fft``, and bins come
    last.
    """
    frames = np.lib.stride_tricks.sliding_window_view(audio, window, axis=-1)[..., ::hop, :]
    windowed = (frames * hann(window)).astype(np.float32, copy=False)
    spectra: ComplexArray = scipy.fft.rfft(windowed, n_fft, axis=-1, overwrite_x=True)
    return spectra


@lru_cache(maxsize=8)
def mel_filters(num_filters: int, n_fft: int, low: float = 0.0, high: float = 8000.0) -> FloatArray:
    """Triangles (B, F) float32 of height 1, equally wide in mel, between two frequencies in hertz.

    The mel scale is O'Shaughnessy's, 1987: 2595 log10(1 + f / 700). Neighbours add up to 1.
    """
    edges = np.linspace(_mel(low), _mel(high), num_filters + 2)
    mels = _mel(np.arange(n_fft // 2 + 1) * (SAMPLE_RATE / n_fft))
    rising = (mels - edges[:-2, None]) / (edges[1] - edges[0])
    triangles: FloatArray = np.maximum(0, np.minimum(rising, 2 - rising)).astype(np.float32)
    return triangles


def _mel(frequency: FloatArray | float) -> FloatArray:
    mels: FloatArray = 2595 * np.log10(1 + np.asarray(frequency) / 700)
    return mels


def log_mel(spectra: ComplexArray, filters: FloatArray) -> FloatArray:
    """Log power (..., N, L, B) float32 in mel bands relative to the window's mean.

    The recording's gain cancels; level differences between microphones stay.
    """
    return log_level((spectra.real**2 + spectra.imag**2) @ filters.T)


def log_level(power: FloatArray) -> FloatArray:
    """Log power (..., N, L, B) relative to the window's mean over all microphones and bands."""
    mean = np.maximum(power.mean(axis=(-3, -2, -1), keepdims=True), _TINY)
    level: FloatArray = np.log(power / mean + np.float32(LEVEL_FLOOR))
    return level


def pairs(num_microphones: int) -> tuple[IntArray, IntArray]:
    """First and second microphone of the P = N (N - 1) / 2 pairs."""
    return np.triu_indices(num_microphones, 1)


def gcc_phat(spectra: ComplexArray, lags: FloatArray) -> FloatArray:
    """Generalised cross-correlation with phase transform (Knapp and Carter, 1976) of every frame.

    ``lags`` (D,) are in samples and may be fractional. Returns (..., P, L, D) float32; a pure delay
    of d samples has the value 1 at lag d.
    """
    basis = _lag_basis(spectra.shape[-1], tuple(lags))
    phases = unit_phases(spectra)
    # One pair at a time: the cross-spectra of all pairs would take too much memory.
    correlations = []
    for i, j in zip(*pairs(spectra.shape[-3]), strict=True):
        cross = phases[..., i, :, :] * phases[..., j, :, :].conj()
        parts = np.ascontiguousarray(cross, dtype=np.complex64).view(np.float32)
        correlations.append(parts @ basis)
    return np.stack(correlations, axis=-3)


def gcc_filter_bank(spectra: ComplexArray, filters: FloatArray, lags: FloatArray) -> FloatArray:
    """GCC-PHAT in bands (GCCFB), averaged over the frames: (..., P, B, D) float32.

    Whitened cross-spectra are weighted with a band's filter (B, F) and transformed to ``lags`` (D,)
    in samples (He, Motlicek and Odobez, 2018); a pure delay has the value 1.
    """
    basis = _lag_basis(spectra.shape[-1], tuple(lags))
    scale = 2 * (spectra.shape[-1] - 1) / (filters @ _sides(spectra.shape[-1]))
    scaled = np.repeat(filters * scale[:, None].astype(np.float32), 2, axis=-1)
    phases = unit_phases(spectra)
    correlations = []
    for i, j in zip(*pairs(spectra.shape[-3]), strict=True):
        cross = (phases[..., i, :, :] * phases[..., j, :, :].conj()).mean(axis=-2)
        parts = np.ascontiguousarray(cross, dtype=np.complex64).view(np.float32)
        correlations.append((parts[..., None, :] * scaled) @ basis)
    return np.stack(correlations, axis=-3)


def unit_phases(spectra: ComplexArray) -> ComplexArray:
    """The spectra with modulus 1, or 0 where they are 0; phase differences stay."""
    modulus = np.sqrt(spectra.real**2 + spectra.imag**2)
    phases: ComplexArray = spectra * (1 / np.maximum(modulus, _TINY))
    return phases


def _sides(num_bins: int) -> FloatArray:
    """Number of times that each bin of a one-sided spectrum occurs in the two-sided one."""
    sides = np.full(num_bins, 2, dtype=np.float32)
    sides[[0, -1]] = 1
    return sides


@lru_cache(maxsize=8)
def _lag_basis(num_bins: int, lags: tuple[float, ...]) -> FloatArray:
    """The inverse real Fourier transform at lags in samples, (2 F, D) float32.

    Rows alternate real and imaginary parts of the bins, as complex numbers lie in memory. For a few
    lags of a long transform a matrix costs less than an FFT, and fractional lags cost no more.
    """
    n_fft = 2 * (num_bins - 1)
    angle = 2 * np.pi / n_fft * np.arange(num_bins)[:, None] * np.asarray(lags)
    weights = _sides(num_bins)[:, None] / n_fft
    basis = np.stack([weights * np.cos(angle), -weights * np.sin(angle)], axis=1)
    return basis.reshape(2 * num_bins, -1).astype(np.float32)
