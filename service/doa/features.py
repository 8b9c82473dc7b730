"""Array-independent features of a multichannel spectrogram, the weights network's input.

Nothing in them depends on the number, the order or the places of the microphones: a level, its
onset, and how far the channel vector keeps its direction from frame to frame and from bin to bin,
which it does while one source's direct sound dominates.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import ComplexArray, FloatArray

NUM_FEATURES = 5
BIN_LAG = 2  # windowed noise is all but independent there, and no array turns far in 62 Hz
LEVEL_FLOOR = 1e-5  # of the window's mean power, 50 dB down: quieter cells look alike
LEVEL_SCALE = 0.25  # brings the natural logarithm of power to unit spread


def coherence_features(spectra: ComplexArray, mean_power: FloatArray | None = None) -> FloatArray:
    """Level, onset and the coherences of every time-frequency cell with its neighbours.

    Parameters
    ----------
    spectra : (..., N, F, L) complex64
    mean_power : (...,) float32, optional
        Mean over cells of ||x||^2 that levels are relative to; by default that of ``spectra``. A
        stream gives that of its last second with a few frames.

    Returns
    -------
    features : (..., 5, F, L) float32
        Log power of the channel vector relative to the mean, its difference to the frame
        before, and |x_t^H x_(t-1)|, |x_t^H x_(t-2)| and |x_f^H x_(f-2)| of vectors of unit norm.
        Cells without a predecessor hold zeros. In memory frames come before bins.
    """
    frames = np.swapaxes(spectra, -1, -2)  # the STFT's order in memory, and the network's
    power = np.sum(frames.real**2 + frames.imag**2, axis=-3)  # (..., L, F)
    tiny = np.finfo(np.float32).tiny
    reference = power.mean(axis=(-2, -1)) if mean_power is None else mean_power
    mean = np.maximum(reference, tiny)[..., None, None]
    level = np.float32(LEVEL_SCALE) * np.log(power / mean + np.float32(LEVEL_FLOOR))
    unit = frames / np.sqrt(np.maximum(power, tiny))[..., None, :, :]
    conjugate = np.conj(unit)
    features = np.zeros((*power.shape[:-2], NUM_FEATURES, *power.shape[-2:]), dtype=np.float32)
    features[..., 0, :, :] = level
    np.subtract(level[..., 1:, :], level[..., :-1, :], out=features[..., 1, 1:, :])
    for lag in (1, 2):
        product = unit[..., lag:, :] * conjugate[..., :-lag, :]
        np.abs(product.sum(axis=-3), out=features[..., 1 + lag, lag:, :])
    product = unit[..., BIN_LAG:] * conjugate[..., :-BIN_LAG]
    np.abs(product.sum(axis=-3), out=features[..., 4, :, BIN_LAG:])
    return np.swapaxes(features, -1, -2)
