"""Magnitude and phase of a multichannel spectrogram, the regression network's input.

Unlike ``features``, these are bound to one array: channel n is always microphone n. Nothing is
resized: a frame of the features is a frame of the STFT. Resizing a spectrogram like an image to fit
a network's input averages wrapped phases and destroys the delays between microphones that
localization needs.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from service.doa.features import LEVEL_FLOOR, LEVEL_SCALE
from service.doa.types import ComplexArray, FloatArray

PhaseReference = Literal["absolute", "first"]
"""Reference of phases: none, or microphone 0"""


LOUDEST = 3.0
"""Most that ``level_exponent`` makes of a cell"""


def spectrogram_features(
    spectra: ComplexArray, reference: PhaseReference = "first", level_exponent: float = 0.0
) -> FloatArray:
    """Two real features per microphone for every time-frequency cell.

    Parameters
    ----------
    spectra : (..., N, F, L) complex64
    reference : str
        ``"first"`` turns every cell's channel vector until microphone 0 has phase zero and scales
        it to unit norm: its N real parts, the imaginary parts of microphones 1 to N - 1 and, in
        place of the imaginary part that is zero, the cell's log level. Only the phase common to
        all microphones is lost, which tells nothing about directions, and there is no jump at pi.

        ``"absolute"`` is the paper's text: first the N magnitudes, then the N wrapped phases
        divided by pi. A magnitude is a log power relative to the window's mean power over all
        microphones, so that the recording's gain cancels and level differences between
        microphones stay. Networks learn very slowly from it, since a delay is a difference of two
        phases modulo 2 pi.
    level_exponent : float
        With ``"first"``, cells have not unit norm but (power / mean power)^level_exponent, at most
        ``LOUDEST``: 0.15 keeps the magnitudes that the paper's text feeds in a range that networks
        bear.

    Returns
    -------
    features : (..., 2 N, F, L) float32
    """
    power = spectra.real**2 + spectra.imag**2  # (..., N, F, L)
    if reference == "absolute":
        phase = np.angle(spectra) / np.float32(np.pi)
        return np.concatenate([_level(power), phase], axis=-3).astype(np.float32, copy=False)
    total = power.sum(axis=-3, keepdims=True)  # (..., 1, F, L)
    first = spectra[..., :1, :, :]
    turn = np.conj(first) / np.maximum(np.abs(first), _TINY)
    unit = spectra * turn / np.sqrt(np.maximum(total, _TINY))
    if level_exponent:
        loudness = (total / _mean(total)) ** np.float32(level_exponent)
        unit *= np.minimum(loudness, np.float32(LOUDEST))
    return np.concatenate(
        [unit.real, _level(total), unit.imag[..., 1:, :, :]], axis=-3, dtype=np.float32
    )


_TINY = np.finfo(np.float32).tiny


def _level(power: FloatArray) -> FloatArray:
    """Log power (..., C, F, L) relative to the mean over channels, bins and frames."""
    scaled = power / _mean(power) + np.float32(LEVEL_FLOOR)
    level: FloatArray = np.float32(LEVEL_SCALE) * np.log(scaled)
    return level


def _mean(power: FloatArray) -> FloatArray:
    """Mean over channels, bins and frames, never 0."""
    mean: FloatArray = np.maximum(power.mean(axis=(-3, -2, -1), keepdims=True), _TINY)
    return mean
