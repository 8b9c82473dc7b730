"""Masks for self-supervised spatial correlation learning: one microphone loses most of its cells.

After the paper's SSCL: a random microphone is masked in a span of time, in a band of frequencies or
in scattered cells, and has to be reconstructed from what is left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.doa.spectrogram import spectrogram_features
from service.doa.types import BoolArray, ComplexArray, FloatArray, IntArray

MASKED_SHARE = (0.4, 0.75)
"""Of the microphone's cells, uniform; of a tenth, as in the paper's code, the neighbours tell"""


def draw_mask(rng: np.random.Generator, num_bins: int, num_frames: int) -> BoolArray:
    """One span of frames, one band of bins or scattered cells, each as likely: (F, L) bool."""
    share = rng.uniform(*MASKED_SHARE)
    mask = np.zeros((num_bins, num_frames), dtype=bool)
    match rng.integers(3):
        case 0:
            mask[:, _stretch(rng, num_frames, share)] = True
        case 1:
            mask[_stretch(rng, num_bins, share)] = True
        case _:
            mask[:] = rng.random(mask.shape) < share
    return mask


def masked_features(
    spectra: ComplexArray, microphone: IntArray, mask: BoolArray, level_exponent: float = 0.0
) -> FloatArray:
    """The network's features when one microphone is silent in the masked cells.

    The mask falls on the spectra, not on the features, whose norm and level would tell of the
    microphone. Phases are relative to microphone 0; where that is the masked one, to microphone 1,
    so that the others' phases do not vanish with it.

    Parameters
    ----------
    spectra : (B, N, F, L) complex64
    microphone : (B,) int
        The masked one of every scene.
    mask : (B, F, L) bool
    level_exponent : float
        As ``spectrogram_features`` has it.

    Returns
    -------
    features : (B, 2 N, F, L) float32
        As ``spectrogram_features`` with the reference ``"first"`` gives them. In the masked cells
        the microphone's own are zero; of microphone 1 as a reference, the imaginary part is.
    """
    scenes = np.arange(len(spectra))
    masked = spectra.copy()
    masked[scenes, microphone] = np.where(mask, 0, masked[scenes, microphone])
    without_first = (mask & (microphone == 0)[:, None, None])[:, None]  # (B, 1, F, L)
    # Microphones 0 and 1 change places for the computation, and their real parts back after it;
    # the imaginary part that then stands at microphone 1 is that of the silent microphone 0.
    features = spectrogram_features(_swapped(masked, without_first), level_exponent=level_exponent)
    return _swapped(features, without_first)


def _stretch(rng: np.random.Generator, length: int, share: float) -> slice:
    size = round(share * length)
    start = int(rng.integers(length - size + 1))
    return slice(start, start + size)


def _swapped(values: NDArray[Any], where: BoolArray) -> NDArray[Any]:
    """``values`` (B, C, F, L) with channels 0 and 1 exchanged ``where`` (B, 1, F, L) says."""
    exchanged = values.copy()
    exchanged[:, :2] = np.where(where, values[:, 1::-1], values[:, :2])
    return exchanged
