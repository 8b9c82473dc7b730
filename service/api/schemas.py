"""Answers about models and arrays; ``service.recordings`` has those about recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

from neuralmusic.arrays import RAW_CHANNELS
from service.doa.array import MicrophoneArray
from service.inference.bundle import Bundle
from service.inference.manifest import Purpose
from service.recordings.answers import Answer, ModelAnswer, Position


class BoundArrayAnswer(Answer):
    """The array that a model is bound to."""

    name: str
    positions_m: list[Position]
    """Metres, in channel order"""


class BundleAnswer(ModelAnswer):
    """A loaded model bundle."""

    description: str
    purpose: Purpose
    """`localization`, or `comparison` for a model that another one surpasses wherever it fits"""
    array: Literal["any"] | BoundArrayAnswer
    """The array that the model is bound to, or `any`"""
    sample_rate: int
    """Hertz to which recordings are resampled"""
    max_sources: int
    """Most sources that the model can count"""
    scores: dict[str, Any]
    """Results on held-out speakers, with the protocol of the measurement"""
    licences: list[str]
    """Licences of the training data"""
    default: bool
    """True for the model of requests that name none, where it fits their array"""
    details: str
    """Path of this answer with the model's card"""

    @classmethod
    def of(cls, bundle: Bundle, *, default: bool) -> Self:
        manifest = bundle.manifest
        bound = bundle.bound_array()
        return cls(
            **manifest.model_dump(
                include={"name", "version", "variant", "description", "purpose", "max_sources"}
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
    """The `channel_map` of the raw microphones by the recording's channel count"""
    source: str
    """Source of the positions"""

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
    """Models, the best first; those of the purpose `comparison` come last"""

    @classmethod
    def of(cls, bundles: Sequence[Bundle]) -> Self:
        return cls(models=[BundleAnswer.of(b, default=b is bundles[0]) for b in bundles])


class ArraysAnswer(Answer):
    """The array presets."""

    arrays: list[PresetAnswer]
