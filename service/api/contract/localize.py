"""What types cannot tell the OpenAPI document: bodies, options, examples, errors."""

from __future__ import annotations

from typing import Any

from neuralmusic.errors import (
    AudioTooLong,
    ChannelMismatch,
    DecodingFailed,
    DiskFull,
    DoaError,
    Draining,
    EmptyAudio,
    GeometryMismatch,
    InvalidChannelMap,
    InvalidGeometry,
    InvalidOption,
    MissingAudio,
    NoiseMismatch,
    NonFiniteAudio,
    NotAudio,
    NotReady,
    Overloaded,
    RequestTimeout,
    TooManyChannels,
    TooManyConnections,
    TooManySources,
    TooSlow,
    TruncatedAudio,
    UnknownArray,
    UnknownMethod,
    UnknownModel,
    UnknownNoise,
    UnsupportedMediaType,
    UnsupportedSampleRate,
    UploadError,
    UploadTooLarge,
    WorkerLost,
)
from service.recordings.options import OPTIONS, Option

LOCALIZE_ERRORS: tuple[type[DoaError], ...] = (
    UploadError,
    UploadTooLarge,
    RequestTimeout,
    UnsupportedMediaType,
    MissingAudio,
    NotAudio,
    EmptyAudio,
    TruncatedAudio,
    NonFiniteAudio,
    DecodingFailed,
    AudioTooLong,
    TooManyChannels,
    UnsupportedSampleRate,
    ChannelMismatch,
    UnknownArray,
    InvalidGeometry,
    InvalidChannelMap,
    InvalidOption,
    UnknownMethod,
    UnknownModel,
    GeometryMismatch,
    UnknownNoise,
    NoiseMismatch,
    TooManySources,
    Overloaded,
    TooManyConnections,
    DiskFull,
    NotReady,
    Draining,
    TooSlow,
    WorkerLost,
    DoaError,
)

LOCALIZE_EXAMPLE: dict[str, Any] = {
    "model": {
        "name": "any-array",
        "version": "0.4.0",
        "variant": "weights",
        "sha256": "4ad0c6bdcc322c347ab0735df718e644fe71e2c523ddbf26ba6d44e8d3b7568c",
    },
    "method": "neural",
    "audio": {"sample_rate": 16000, "channels": 4, "duration_s": 8.5},
    "array": {
        "name": "respeaker-usb-4mic-v2",
        "positions_m": [
            [0.02285, 0.02285, 0.0],
            [-0.02285, 0.02285, 0.0],
            [-0.02285, -0.02285, 0.0],
            [0.02285, -0.02285, 0.0],
        ],
        "channel_map": [0, 1, 2, 3],
        "why_no_elevation": "the microphones lie in a level plane, which hears a source above it "
        "and its mirror image below it alike: say hemisphere=upper or lower where all sources are "
        "on one side",
    },
    "windows": [
        {
            "t_start": 7.168,
            "t_end": 8.192,
            "num_sources": 2,
            "sources": [
                {
                    "azimuth_deg": 45.53,
                    "confidence": 0.993,
                    "id": 1,
                    "elevation_deg": None,
                    "unit_vector": [0.7006, 0.71356, 0.0],
                },
                {
                    "azimuth_deg": 199.98,
                    "confidence": 0.949,
                    "id": 2,
                    "elevation_deg": None,
                    "unit_vector": [-0.9398, -0.34172, 0.0],
                },
            ],
        }
    ],
    "summary": {
        "sources": [
            {"azimuth_deg": 45.94, "confidence": 0.981, "share": 0.875, "elevation_deg": None},
            {"azimuth_deg": 199.89, "confidence": 0.97, "share": 0.688, "elevation_deg": None},
        ]
    },
    "warnings": [],
}
"""The service's answer to ``examples/two-talkers.flac``, with one of its 16 windows"""

_BINARY = {"schema": {"type": "string", "format": "binary"}}


def localize_operation() -> dict[str, Any]:
    """Parameters and request bodies of ``POST /localize``."""
    parameters = [
        # No parameter is required: each may be a form field instead.
        {"name": name, "in": "query", "required": False, **_described(option)}
        for name, option in OPTIONS.items()
    ]
    return {"parameters": parameters, "requestBody": _request_body()}


def document_answer(document: dict[str, Any]) -> None:
    """Add the example to an OpenAPI document; FastAPI itself would leave out what is null."""
    answer = document["paths"]["/localize"]["post"]["responses"]["200"]
    answer["content"]["application/json"]["example"] = LOCALIZE_EXAMPLE


def _request_body() -> dict[str, Any]:
    fields: dict[str, Any] = {
        "audio": {
            "type": "string",
            "format": "binary",
            "description": "The recording: WAV, FLAC or another file that libsndfile reads.",
        }
    }
    for name, option in OPTIONS.items():
        described = _described(option)
        fields[name] = {**described["schema"], "description": described["description"]}
    return {
        "required": True,
        "description": "The recording as a form's file `audio` with options beside it, or as the "
        "raw body with options in the query.",
        "content": {
            "multipart/form-data": {
                "schema": {"type": "object", "required": ["audio"], "properties": fields}
            },
            "audio/*": _BINARY,
            "application/octet-stream": _BINARY,
        },
    }


def _described(option: Option) -> dict[str, Any]:
    schema = dict(option.schema)
    if option.example is not None:
        schema["examples"] = [option.example]
    return {"description": option.description, "schema": schema}
