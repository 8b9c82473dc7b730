"""Base of the classical methods, which are told the number of sources.

What depends on the array alone, such as steering vectors, is computed once for consecutive scenes
of the same array.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, TypeVar

import numpy as np

from model_export.baselines.method import Card, Estimate
from service.doa.array import MicrophoneArray
from service.doa.stft import Stft
from service.doa.types import BoolArray, FloatArray, IntArray

STFT = Stft()
"""Framing of every classical method: the service's own"""
SPEECH_BAND = (300.0, 3500.0)
"""Hertz, as in the service's classical methods. Below it a 46 mm array has hardly any delay; above
it speech is weak, and from c / (2 d) = 3750 Hz the delays of the square's sides are ambiguous."""

PreparedT = TypeVar("PreparedT")


class ToldMethod(ABC, Generic[PreparedT]):
    """A method that needs the count; subclasses prepare an array and estimate a window."""

    card: ClassVar[Card]
    counts = False

    def __init__(self) -> None:
        self._positions = b""
        self._prepared: PreparedT | None = None

    @abstractmethod
    def prepare(self, array: MicrophoneArray) -> PreparedT:
        """Compute what depends on the array alone; ValueError if the method does not fit it."""

    @abstractmethod
    def estimate(self, audio: FloatArray, prepared: PreparedT, num_sources: int) -> Estimate:
        """Estimate at most ``num_sources`` directions of one window (N, T) that is not silent."""

    def localize(
        self, audio: FloatArray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        """Directions of one window, as in ``Method.localize``.

        A window of zeros has no direction. A signal subspace has at most one dimension less than
        there are microphones.

        Raises
        ------
        ValueError
            If the count is missing or below 1, the audio does not have the array's channels or is
            shorter than a frame, or the method cannot be used with the array.
        """
        if num_sources is None or num_sources < 1:
            raise ValueError(
                f"{self.card.title} has to be told the number of sources, 1 or more, not "
                f"{num_sources}: it cannot count them"
            )
        if audio.ndim != 2 or len(audio) != array.num_microphones:
            raise ValueError(
                f"audio of shape {audio.shape} does not fit array {array.name!r}: "
                f"{self.card.title} takes ({array.num_microphones}, samples)"
            )
        if audio.shape[1] < STFT.n_fft:
            raise ValueError(
                f"a window of {audio.shape[1]} samples is shorter than a frame of {STFT.n_fft}"
            )
        if self._prepared is None or self._positions != array.positions.tobytes():
            self._prepared = self.prepare(array)
            self._positions = array.positions.tobytes()
        if not audio.any():
            return Estimate(np.empty(0))
        return self.estimate(audio, self._prepared, num_sources)


def band_bins(band: tuple[float, float]) -> IntArray:
    """Indices of the bins of ``STFT`` whose centres lie in a band in hertz, ends included."""
    bins: IntArray = np.flatnonzero((STFT.frequencies >= band[0]) & (STFT.frequencies <= band[1]))
    return bins


def searched_peaks(spectrum: FloatArray, searched: BoolArray, num_sources: int) -> Estimate:
    """Estimate from the highest circular maxima of a spectrum (A,) at searched azimuths (A,)."""
    return Estimate.of_spectrum(np.where(searched, spectrum, spectrum.min()), num_sources)
