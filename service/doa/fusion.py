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
