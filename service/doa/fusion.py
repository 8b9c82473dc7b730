"""Frequency attention fusion (FAF): from one spectrum per frequency to the broadband spectrum.

P(theta) = sum_f alpha_f P(f, theta) (the NeuralMUSIC paper's FAF). Per-frequency spectra are
divided by their maximum first: unnormalised MUSIC spans six decades and single bins would decide.
"""

from __future__ import annotations

import numpy as np

from service.doa.types import FloatArray


def normalise(spectrum: FloatArray) -> FloatArray:
    """Divide every spectrum (..., A) by its maximum over the angles."""
    peak = spectrum.max(axis=-1, keepdims=True)
    normalised: FloatArray = spectrum / np.maximum(peak, np.finfo(np.float32).tiny)
    return normalised


def attention_fusion(spectra: FloatArray, attention: FloatArray) -> FloatArray:
    """Weighted mean of spectra: sum a P / sum a.

    Parameters
    ----------
    spectra : (..., K, A) float32
        One spectrum per frequency bin, or per frequency bin and block.
    attention : (..., K) float32
        Non-negative; all zeros give a zero spectrum.

    Returns
    -------
    fused : (..., A) float32
    """
    total = attention.sum(axis=-1)[..., None]
    fused: FloatArray = (attention[..., None, :] @ spectra)[..., 0, :]
    fused = fused / np.maximum(total, np.finfo(np.float32).tiny)
    return fused


def mean_fusion(spectra: FloatArray) -> FloatArray:
    """Incoherent average over frequency: (..., F, A) -> (..., A), the classical methods' fusion."""
    mean: FloatArray = spectra.mean(axis=-2)
    return mean


def normalised_fusion(spectra: FloatArray) -> FloatArray:
    """``mean_fusion`` of ``normalise``, without the array between them."""
    peak = np.maximum(spectra.max(axis=-1), np.finfo(np.float32).tiny)
    shares = np.float32(1 / spectra.shape[-2]) / peak
    fused: FloatArray = (shares[..., None, :] @ spectra)[..., 0, :]
    return fused


def attention_weights(spectra: FloatArray, squeeze: FloatArray, excite: FloatArray) -> FloatArray:
    """Attention of every frequency bin from its spectrum's mean over the angles.

    alpha = sigmoid(W2 relu(W1 mean_theta P(f, theta))), the paper's FAF with r = 16.

    Parameters
    ----------
    spectra : (..., F, A) float32
    squeeze : (F / r, F) float32
        W1.
    excite : (F, F / r) float32
        W2.

    Returns
    -------
    attention : (..., F) float32
        Between 0 and 1.
    """
    pooled = spectra.mean(axis=-1)
    hidden = np.maximum(pooled @ squeeze.T, 0)
    return sigmoid(hidden @ excite.T)


def sigmoid(logits: FloatArray) -> FloatArray:
    """1 / (1 + exp(-x)), in float32 also of logits in the hundreds.

    Windows unlike any in training, digital silence among them, give such.
    """
    chances: FloatArray = 1 / (1 + np.exp(-np.clip(logits, -80, 80)))
    return chances
