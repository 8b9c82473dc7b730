"""Array-independent features of a multichannel spectrogram, the weights network's input.

They do not depend on the number, the order or the places of the microphones: a level, its onset,
and how well the channel vector keeps its direction from frame to frame and from bin to bin, as it
does while one source's direct sound dominates.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray

NUM_FEATURES = 5
LAGS = (1, 2)  # frames
BIN_LAG = 2  # windowed noise is almost independent two bins apart, and no phase turns far in 62 Hz
LEVEL_FLOOR = 1e-5  # of the window's mean power, 50 dB down: quieter cells look alike
LEVEL_SCALE = 0.25  # brings the natural logarithm of power to unit spread


def unit_vectors_and_power(spectra: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Every cell's channel vector with unit norm, and its power.

    Parameters
    ----------
    spectra : (..., N, F, L) complex64

    Returns
    -------
    unit : (..., N, F, L) complex64
        Zero where there is nothing.
    power : (..., F, L) float32
        ||x||^2.

    In memory frames come before bins in both, as in the STFT.
    """
    frames = np.swapaxes(spectra, -1, -2)
    if frames.strides[-1] != frames.itemsize:
        frames = np.ascontiguousarray(frames)
    squares = np.square(frames.view(np.float32)).sum(axis=-3)  # of real and imaginary parts
    power = squares[..., ::2] + squares[..., 1::2]  # (..., L, F)
    # Dividing a complex array by a real one would be slow.
    scale = 1 / np.sqrt(np.maximum(power, np.finfo(np.float32).tiny))
    unit = frames * scale[..., None, :, :]
    return np.swapaxes(unit, -1, -2), np.swapaxes(power, -1, -2)


def coherence_features(
    unit: ComplexArray, power: FloatArray, mean_power: FloatArray | None = None
) -> FloatArray:
    """Level, onset and coherences with its neighbours of every time-frequency cell.

    Parameters
    ----------
    unit, power : (..., N, F, L) complex64, (..., F, L) float32
        From ``unit_vectors_and_power``.
    mean_power : (...,) float32, optional
        Mean over cells of ||x||^2 to which levels are relative; by default the mean of ``power``. A
        stream gives the mean of its last second with a few frames.

    Returns
    -------
    features : (..., 5, F, L) float32
        Log power of the channel vector relative to the mean, its difference to the frame
        before, and |x_t^H x_(t-1)|, |x_t^H x_(t-2)| and |x_f^H x_(f-2)| of vectors of unit norm.
        Cells without a predecessor hold zeros. In memory frames come before bins.
    """
    return window_features(coherences(unit), power, mean_power)


def coherences(unit: ComplexArray) -> FloatArray:
    """|x_t^H x_(t-1)|, |x_t^H x_(t-2)| and |x_f^H x_(f-2)| of unit vectors (..., N, F, L).

    The result is (..., 3, F, L) float32, zero where there is no predecessor; in memory frames come
    before bins.
    """
    unit = np.swapaxes(unit, -1, -2)
    conjugate = np.conj(unit)
    found = np.zeros((*unit.shape[:-3], 3, *unit.shape[-2:]), dtype=np.float32)
    for lag in LAGS:
        product = unit[..., lag:, :] * conjugate[..., :-lag, :]
        np.abs(product.sum(axis=-3), out=found[..., lag - 1, lag:, :])
    product = unit[..., BIN_LAG:] * conjugate[..., :-BIN_LAG]
    np.abs(product.sum(axis=-3), out=found[..., 2, :, BIN_LAG:])
    return np.swapaxes(found, -1, -2)


def window_features(
    coherence: FloatArray, power: FloatArray, mean_power: FloatArray | None = None
) -> FloatArray:
    """The features of windows with known ``coherences``, which may reach frames before the window.

    Parameters and result are those of ``coherence_features``, with ``coherence`` (..., 3, F, L).
    """
    coherence, power = np.swapaxes(coherence, -1, -2), np.swapaxes(power, -1, -2)
    reference = power.mean(axis=(-2, -1)) if mean_power is None else mean_power
    mean = np.maximum(reference, np.finfo(np.float32).tiny)[..., None, None]
    level = np.float32(LEVEL_SCALE) * np.log(power / mean + np.float32(LEVEL_FLOOR))
    features = np.empty((*power.shape[:-2], NUM_FEATURES, *power.shape[-2:]), dtype=np.float32)
    features[..., 0, :, :] = level
    np.subtract(level[..., 1:, :], level[..., :-1, :], out=features[..., 1, 1:, :])
    features[..., 1, 0, :] = 0
    features[..., 2:, :, :] = coherence
    for lag in LAGS:
        features[..., 1 + lag, :lag, :] = 0
    return np.swapaxes(features, -1, -2)
