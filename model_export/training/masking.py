"""Masks for self-supervised spatial correlation learning: one microphone loses most of its cells.

As in the paper's SSCL, a random microphone is masked in a span of time, in a band of frequencies
or in scattered cells, and has to be reconstructed from the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.doa.spectrogram import spectrogram_features
from service.doa.types import BoolArray, ComplexArray, FloatArray, IntArray

MASKED_SHARE = (0.4, 0.75)
"""Range of the share of masked cells, uniform; the tenth of the paper's code can be guessed from
neighbouring cells"""


def draw_mask(rng: np.random.Generator, num_bins: int, num_frames: int) -> BoolArray:
    """Mask (F, L) bool: a span of frames, a band of bins or scattered cells, equally likely."""
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

    The spectra are masked, not the features: norm and level of the features would leak the masked
    microphone. Phases are relative to microphone 0, or to microphone 1 where microphone 0 is
    masked, so that the others keep their phases.

    Parameters
    ----------
    spectra : (B, N, F, L) complex64
    microphone : (B,) int
        The masked microphone of every scene.
    mask : (B, F, L) bool
    level_exponent : float
        Exponent of the level, see ``spectrogram_features``.

    Returns
    -------
    features : (B, 2 N, F, L) float32
        The features of ``spectrogram_features`` with the reference ``"first"``. In the masked cells
        those of the masked microphone are zero, as is microphone 1's imaginary part where it is the
        reference.
    """
    scenes = np.arange(len(spectra))
    masked = spectra.copy()
    masked[scenes, microphone] = np.where(mask, 0, masked[scenes, microphone])
    without_first = (mask & (microphone == 0)[:, None, None])[:, None]  # (B, 1, F, L)
    # Microphones 0 and 1 change places for the computation, and their real parts change back after
    # it; the imaginary part that stays at microphone 1 is that of the silent microphone 0.
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
