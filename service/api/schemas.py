"""The answers of the HTTP interface; radians become degrees here and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict

from service.doa.array import MicrophoneArray
from service.doa.presets import RAW_CHANNELS
from service.inference.bundle import Bundle
from service.inference.results import Method, RecordingResult, Source, SummarySource, WindowResult
from service.protocol.degrees import azimuth_deg, unit_vector

Position = tuple[float, float, float]


class Answer(BaseModel):
    """A part of an answer."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)


class ModelAnswer(Answer):
    """The bundle that answered."""

    name: str
    version: str
    variant: str
    """`weights` (any array) or `regression` (bound to one)"""
    sha256: str
    """Of its `bundle.json`, which holds the hashes of all other files"""


class AudioAnswer(Answer):
    """The recording as it came."""

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


class SourceAnswer(Answer):
    """One direction of arrival."""

    azimuth_deg: float
    """Degrees in [0, 360), counter-clockwise from the array's +x"""
    confidence: float
    """0 to 1: about the chance that a source is within 10 degrees"""
    id: int | None
    """The same for one source in all windows; null before it was tracked"""
    elevation_deg: None = None
    """Not estimated: a planar array cannot tell above from below"""
    unit_vector: list[float]
    """`[x, y, z]` towards the source, z = 0"""

    @classmethod
    def of(cls, source: Source) -> Self:
        return cls(
            azimuth_deg=azimuth_deg(source.azimuth),
            confidence=round(source.confidence, 3),
            id=source.id,
            elevation_deg=None,  # named, since what is unset is not sent
            unit_vector=unit_vector(source.azimuth),
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

    @classmethod
    def of(cls, window: WindowResult, *, spectrum: bool) -> Self:
        sources = [SourceAnswer.of(source) for source in window.estimate.sources]
        values = window.estimate.spectrum
        return cls(
            t_start=round(window.t_start, 6),
            t_end=round(window.t_end, 6),
            num_sources=len(sources),
            sources=sources,
            **({"spectrum": [round(float(value), 4) for value in values]} if spectrum else {}),
        )


class SummarySourceAnswer(Answer):
    """A direction that recurs over the recording."""

    azimuth_deg: float
    """Degrees in [0, 360), counter-clockwise from the array's +x"""
    confidence: float
    """Mean confidence of its windows, 0 to 1"""
    share: float
    """Share of the windows with any source in which this one is heard, 0 to 1"""

    @classmethod
    def of(cls, source: SummarySource) -> Self:
        return cls(
            azimuth_deg=azimuth_deg(source.azimuth),
            confidence=round(source.confidence, 3),
            share=round(source.share, 3),
        )


class SummaryAnswer(Answer):
    """The recording as a whole."""

    sources: list[SummarySourceAnswer]
    """Largest share first"""


class WarningAnswer(Answer):
    """Something about the input that the user should know; the answer stands all the same."""

    code: str
    detail: str


class LocalizationAnswer(Answer):
    """Where the sound in a recording comes from."""

    model: ModelAnswer | None
    """Null where a classical method answered"""
    method: Method
    audio: AudioAnswer
    array: ArrayAnswer
    windows: list[WindowAnswer]
    summary: SummaryAnswer
    warnings: list[WarningAnswer]

    @classmethod
    def of(cls, result: RecordingResult) -> Self:
        """Everything but the windows, of which there may be thousands."""
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
            ),
            windows=[],
            summary=SummaryAnswer(sources=[SummarySourceAnswer.of(s) for s in result.summary]),
            warnings=[WarningAnswer(code=w.code, detail=w.detail) for w in result.warnings],
        )


class BoundArrayAnswer(Answer):
    """The array that a model is bound to."""

    name: str
    positions_m: list[Position]
    """Metres, in channel order"""


class BundleAnswer(ModelAnswer):
    """A loaded model bundle."""

    description: str
    array: Literal["any"] | BoundArrayAnswer
    """The array that it is bound to, or `any`"""
    sample_rate: int
    """Hertz that recordings are resampled to"""
    max_sources: int
    """Most sources that it can count"""
    scores: dict[str, Any]
    """Results on held-out speakers, with the protocol that they were measured on"""
    licences: list[str]
    """Licences of the training data"""
    default: bool
    """True where requests that name no model get this one, if it fits their array"""
    details: str
    """Path of this answer with the model's card"""

    @classmethod
    def of(cls, bundle: Bundle, *, default: bool) -> Self:
        manifest = bundle.manifest
        bound = bundle.bound_array()
        return cls(
            **manifest.model_dump(
                include={"name", "version", "variant", "description", "max_sources"}
            ),
            sha256=bundle.sha256,
            array="any"
            if bound is None
            else BoundArrayAnswer(name=bound.name, positions_m=bound.positions.tolist()),
            sample_rate=manifest.stft.sample_rate,
            scores=manifest.scores,
            licences=manifest.licences,
            default=default,
            details=f"/models/{manifest.name}",
        )


class ModelCardAnswer(BundleAnswer):
    """A loaded model bundle with its card."""

    card: str | None = None
    """The model card, Markdown: intended use, data, limits; null where the bundle has none"""

    @classmethod
    def of(cls, bundle: Bundle, *, default: bool) -> Self:
        answer = BundleAnswer.of(bundle, default=default)
        return cls(**answer.model_dump(), card=bundle.card)


class PresetAnswer(Answer):
    """An array that requests may name."""

    name: str
    num_microphones: int
    aperture_m: float
    """Metres between the outermost microphones"""
    positions_m: list[Position]
    """Metres, `[x, y, z]` per raw microphone: x forward, y left, z up"""
    raw_channels: dict[str, list[int]]
    """By the recording's channel count, the `channel_map` of the raw microphones"""
    source: str
    """Where the positions come from"""

    @classmethod
    def of(cls, array: MicrophoneArray) -> Self:
        raw = RAW_CHANNELS.get(array.name, {})
        return cls(
            name=array.name,
            num_microphones=array.num_microphones,
            aperture_m=round(array.aperture, 6),
            positions_m=array.positions.tolist(),
            raw_channels={str(count): list(channels) for count, channels in raw.items()},
            source=array.source,
        )


class ModelsAnswer(Answer):
    """The loaded models."""

    models: list[BundleAnswer]

    @classmethod
    def of(cls, bundles: Sequence[Bundle]) -> Self:
        return cls(models=[BundleAnswer.of(b, default=b is bundles[0]) for b in bundles])


class ArraysAnswer(Answer):
    """The array presets."""

    arrays: list[PresetAnswer]
