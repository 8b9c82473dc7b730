"""The localizer: windows of an array's audio in, directions and spectra out."""

from __future__ import annotations

from typing import Protocol

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import Bundle
from service.inference.regression import RegressionLocalizer
from service.inference.results import WindowEstimate
from service.inference.weights import WeightsLocalizer


class Localizer(Protocol):
    """Anything that localizes windows: a bundle's networks or a classical method."""

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window (B, N, T) float32, T samples at 16 kHz."""
        ...


def localizer_of(bundle: Bundle, array: MicrophoneArray) -> Localizer:
    """The localizer of a bundle's variant for an array that the bundle fits."""
    if bundle.manifest.variant == "weights":
        return WeightsLocalizer(bundle, array)
    return RegressionLocalizer(bundle, array)
