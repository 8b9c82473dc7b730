"""The localizer: windows of an array's audio in, directions and spectra out."""

from __future__ import annotations

from typing import Protocol

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.methods import Hemisphere
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import Bundle
from service.inference.regression import RegressionLocalizer
from service.inference.results import WindowEstimate
from service.inference.weights import WeightsLocalizer
from service.inference.windows import Stretch


class Localizer(Protocol):
    """Anything that localizes windows: a bundle's networks or a classical method."""

    nothing: WindowEstimate
    """Its estimate of a silent window"""

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window (B, N, T) float32, T samples at 16 kHz."""
        ...


def localizer_of(
    bundle: Bundle,
    array: MicrophoneArray,
    noise: NoiseCovariance | None = None,
    hemisphere: Hemisphere = "both",
) -> Localizer:
    """The localizer of a bundle for an array that the bundle fits.

    A network that is bound to one array hears azimuths, whatever the ``hemisphere``.

    Raises
    ------
    InvalidOption
        If noise is given and the bundle's variant cannot take whitened spectra.
    NoiseMismatch
        If the noise was learnt with another array or other frames.
    """
    if bundle.manifest.variant == "weights":
        return WeightsLocalizer(bundle, array, noise, hemisphere)
    if noise is not None:
        raise InvalidOption(
            f"noise cannot be used with the model {bundle.manifest.name}: its network takes the "
            "array's own spectra, not whitened ones; leave noise out, or choose a model of the "
            "variant weights or a classical method"
        )
    return RegressionLocalizer(bundle, array)


def estimate_stretch(
    localizer: Localizer, stretch: Stretch, num_sources: int | None, max_sources: int
) -> list[WindowEstimate]:
    """Directions of every window of a stretch, the same as for single windows."""
    if isinstance(localizer, WeightsLocalizer):
        return localizer.estimate_stretch(stretch, num_sources, max_sources)
    return localizer.estimate(stretch.windows, num_sources, max_sources)
