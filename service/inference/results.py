"""Results of localizing a window: sources, spectrum, warnings, model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.peaks import wrapped
from service.doa.pose import Rotation
from service.doa.sphere import IMAGE_SHAPE
from service.doa.types import FloatArray

MAX_SOURCES = 4


@dataclass(frozen=True, slots=True)
class Source:
    """One direction of arrival."""

    azimuth: float
    """Radians in [0, 2 pi)"""
    confidence: float
    """0 to 1: the chance that a source is within 10 degrees of there"""
    id: int | None = None
    """Id of the source's track; None before there is one"""
    elevation: float | None = None
    """Radians above the horizontal plane; None where the array or the method tells none"""

    def __post_init__(self) -> None:
        """Bring into range what rounding took out of it: a softmax's sum of 1.0000001, say.

        What is no number is no chance.
        """
        object.__setattr__(self, "azimuth", wrapped(self.azimuth))
        chance = self.confidence if self.confidence > 0 else 0.0
        object.__setattr__(self, "confidence", min(chance, 1.0))


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """The result of one window of audio."""

    sources: tuple[Source, ...]
    """Most confident first"""
    spectrum: FloatArray
    """(A,) broadband spatial spectrum on the azimuth grid, maximum at most 1; (0,) where a
    recording's spectra were not requested"""
    sphere: FloatArray | None = None
    """(36, 72) spatial spectrum on the sphere as ``DirectionGrid.image`` orders it, at most 1; None
    where only azimuths are searched, or a recording's images were not requested"""
    heading: Rotation | None = None
    """Rotation of the frame of all this into the world's, where the array may turn"""


def nothing_heard(num_azimuths: int, *, sphere: bool) -> WindowEstimate:
    """The estimate of silence: spectra of zeros, that of the sphere where it is searched."""
    image = np.zeros(IMAGE_SHAPE, dtype=np.float32) if sphere else None
    return WindowEstimate((), np.zeros(num_azimuths, dtype=np.float32), image)


def sphere_rows(image: FloatArray) -> list[list[float]]:
    """An image of the sphere as it is sent, to a thousandth."""
    rows: list[list[float]] = np.round(image.astype(np.float64), 3).tolist()
    return rows


@dataclass(frozen=True, slots=True)
class AudioWarning:
    """Something about the input that the user should know; the answer is valid all the same."""

    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class ModelIdentity:
    """The bundle that was used."""

    name: str
    version: str
    variant: str
    sha256: str
