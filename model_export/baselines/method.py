"""The interface of all methods of the comparison: audio and array in, directions out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.peaks import find_peaks
from service.doa.types import FloatArray

Kind = Literal["classical", "learned", "hybrid"]
"""Kind of a method; hybrid is a network combined with a subspace method"""


@dataclass(frozen=True, slots=True)
class Card:
    """Name, kind and origin of a method."""

    name: str
    """Name on the command line"""
    title: str
    """Name in tables"""
    kind: Kind
    source: str
    """The publication, and the library if one is used"""
    adaptation: str = ""
    """Differences from the publication, if any"""
    linear_only: bool = False
    """Whether it needs a uniform linear array"""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A method's answer for one window."""

    azimuth: FloatArray
    """(M,) radians, the most confident first; fewer than asked for if it finds no more"""
    spectrum: FloatArray | None = None
    """(A,) on ``azimuth_grid(A)``; None if the method outputs directions only"""

    @classmethod
    def of_spectrum(cls, spectrum: FloatArray, num_sources: int) -> Estimate:
        """Estimate from the spectrum's highest circular maxima."""
        peaks = find_peaks(spectrum, num_sources)
        return cls(np.array([peak.azimuth for peak in peaks]), spectrum)


class Method(Protocol):
    """One method, ready to answer."""

    @property
    def card(self) -> Card: ...

    @property
    def counts(self) -> bool:
        """Whether it estimates the number of sources; otherwise it has to be told."""

    def localize(
        self, audio: FloatArray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        """Directions of one window.

        Parameters
        ----------
        audio : (N, T) float32
            Audio at 16 kHz.
            array : MicrophoneArray
                Array of N microphones.
            num_sources : int, optional
                Known count; may be None only if ``counts``.

        Raises
        ------
        ValueError
            If the method cannot be used with the array, or has to be told the count.
        """
