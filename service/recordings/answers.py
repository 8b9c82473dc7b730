"""The answer to ``POST /localize``, in degrees."""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict

from neuralmusic.protocol.degrees import azimuth_deg, elevation_deg, unit_vector
from neuralmusic.protocol.methods import Method
from service.inference.results import Source, sphere_rows
from service.recordings.results import RecordingResult, SummarySource, WindowResult

Position = tuple[float, float, float]


class Answer(BaseModel):
    """A part of an answer."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)


class ModelAnswer(Answer):
    """The bundle that was used."""

    name: str
    version: str
    variant: str
    """`weights` (any array) or `regression` (bound to one)"""
    sha256: str
    """Hash of its `bundle.json`, which holds the hashes of all other files"""


class AudioAnswer(Answer):
    """The recording as it was sent."""

    sample_rate: int
    """Hertz"""
    channels: int
    duration_s: float
    """Seconds"""


class ArrayAnswer(Answer):
    """The array that was used."""

    name: str
    """A preset's name, the request's, or `custom`"""
    positions_m: list[Position]
    """Metres, `[x, y, z]` per microphone: x forward, y left, z up"""
    channel_map: list[int]
    """The recording's channel of every microphone, from 0"""
    why_no_elevation: str | None = None
    """Why `elevation_deg` is null; null where elevations are told"""


class SourceAnswer(Answer):
    """One direction of arrival."""

    azimuth_deg: float
    """Degrees in [0, 360), counter-clockwise from the array's +x"""
    confidence: float
    """0 to 1: the chance that a source is within 10 degrees of there"""
    id: int | None
    """Identity of the source over all windows; null before it was tracked"""
    elevation_deg: float | None = None
    """Degrees from -90 to 90 above the array's horizontal plane; null where the array or the method
    tells azimuths only, as `array.why_no_elevation` says"""
    unit_vector: list[float]
    """`[x, y, z]` towards the source; z = 0 without an elevation"""

    @classmethod
    def of(cls, source: Source) -> Self:
        return cls(
            azimuth_deg=azimuth_deg(source.azimuth),
            confidence=round(source.confidence, 3),
            id=source.id,
            elevation_deg=elevation_deg(source.elevation),
            unit_vector=unit_vector(source.azimuth, source.elevation),
        )


class WindowAnswer(Answer):
    """One window of the recording."""

    t_start: float
    """Seconds from the recording's start"""
    t_end: float
    """Seconds from the recording's start"""
    num_sources: int
    sources: list[SourceAnswer]
    """Most confident first; empty in silence"""
    spectrum: list[float] | None = None
    """Spatial spectrum at 0, 1, ... 359 degrees, at most 1; only on request"""
    sphere: list[list[float]] | None = None
    """Spatial spectrum on the sphere, at most 1; only on request: 36 rows at the elevations -87.5,
    -82.5, ... 87.5 degrees, each with 72 values at the azimuths 0, 5, ... 355; 0 where the array
    is not searched"""

    @classmethod
    def of(cls, window: WindowResult) -> Self:
        sources = [SourceAnswer.of(source) for source in window.estimate.sources]
        spectrum = [round(float(value), 4) for value in window.estimate.spectrum]
        image = window.estimate.sphere
        return cls(
            t_start=round(window.t_start, 6),
            t_end=round(window.t_end, 6),
            num_sources=len(sources),
            sources=sources,
            **({"spectrum": spectrum} if spectrum else {}),
            **({} if image is None else {"sphere": sphere_rows(image)}),
        )


class SummarySourceAnswer(Answer):
    """A direction that recurs over the recording."""

    azimuth_deg: float
    """Degrees in [0, 360), counter-clockwise from the array's +x"""
    confidence: float
    """Mean confidence of its windows, 0 to 1"""
    share: float
    """Share of the windows with any source in which this one is heard, 0 to 1"""
    elevation_deg: float | None = None
    """Degrees above the horizontal plane; null as in the windows"""

    @classmethod
    def of(cls, source: SummarySource) -> Self:
        return cls(
            azimuth_deg=azimuth_deg(source.azimuth),
            confidence=round(source.confidence, 3),
            share=round(source.share, 3),
            elevation_deg=elevation_deg(source.elevation),
        )


class SummaryAnswer(Answer):
    """The recording as a whole."""

    sources: list[SummarySourceAnswer]
    """Largest share first"""


class WarningAnswer(Answer):
    """Something about the input that the user should know; the answer is valid all the same."""

    code: str
    detail: str


class LocalizationAnswer(Answer):
    """The directions of the sources in a recording."""

    model: ModelAnswer | None
    """The bundle that was used; null for a classical method"""
    method: Method
    audio: AudioAnswer
    array: ArrayAnswer
    windows: list[WindowAnswer]
    summary: SummaryAnswer
    warnings: list[WarningAnswer]

    @classmethod
    def of(cls, result: RecordingResult) -> Self:
        """The answer without its windows, of which there may be thousands."""
        model, array = result.model, result.array
        return cls(
            model=ModelAnswer.model_validate(model, from_attributes=True) if model else None,
            method=result.method,
            audio=AudioAnswer(
                sample_rate=result.sample_rate,
                channels=result.channels,
                duration_s=round(result.duration, 6),
            ),
            array=ArrayAnswer(
                name=array.name,
                positions_m=array.positions.tolist(),
                channel_map=list(result.channel_map),
                why_no_elevation=result.why_no_elevation,
            ),
            windows=[],
            summary=SummaryAnswer(sources=[SummarySourceAnswer.of(s) for s in result.summary]),
            warnings=[WarningAnswer(code=w.code, detail=w.detail) for w in result.warnings],
        )
