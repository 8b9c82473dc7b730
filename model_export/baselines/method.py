"""What every method of the comparison is: multichannel audio and an array in, directions out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.peaks import find_peaks
from service.doa.types import FloatArray

Kind = Literal["classical", "learned", "hybrid"]
"""Hybrid: a network and a subspace method together"""


@dataclass(frozen=True, slots=True)
class Card:
    """What a method is and where it comes from."""

    name: str
    """As on the command line"""
    title: str
    """As in tables"""
    kind: Kind
    source: str
    """The publication, and the library where one is used"""
    adaptation: str = ""
    """How it differs from the publication, where it does"""
    linear_only: bool = False
    """It needs microphones at equal distances on a line"""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a method says of one window."""

    azimuth: FloatArray
    """(M,) radians, the most confident first; fewer than asked for where it finds no more"""
    spectrum: FloatArray | None = None
    """(A,) on ``azimuth_grid(A)``; None of methods that name directions only"""

    @classmethod
    def of_spectrum(cls, spectrum: FloatArray, num_sources: int) -> Estimate:
        """The spectrum's highest circular maxima."""
        peaks = find_peaks(spectrum, num_sources)
        return cls(np.array([peak.azimuth for peak in peaks]), spectrum)


class Method(Protocol):
    """One method, ready to answer."""

    @property
    def card(self) -> Card: ...

    @property
    def counts(self) -> bool:
        """Whether it estimates the number of sources; those that do not have to be told."""

    def localize(
        self, audio: FloatArray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        """Directions of one window.

        Parameters
        ----------
        audio : (N, T) float32
            At 16 kHz.
        array : MicrophoneArray
            With N microphones.
        num_sources : int, optional
            Known count; None only where ``counts``.

        Raises
        ------
        ValueError
            If the method cannot be used with the array, or has to be told the count.
        """
