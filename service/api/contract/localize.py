"""The part of the OpenAPI document that types cannot say: bodies, options, examples, errors."""

from __future__ import annotations

from typing import Any

from service.errors import (
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
    WorkerLost,
    DoaError,
)

LOCALIZE_EXAMPLE: dict[str, Any] = {
    "model": {
        "name": "weights",
        "version": "1.0.0",
        "variant": "weights",
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    },
    "method": "neural",
    "audio": {"sample_rate": 16000, "channels": 6, "duration_s": 1.024},
    "array": {
        "name": "respeaker-usb-4mic-v2",
        "positions_m": [
            [0.02285, 0.02285, 0.0],
            [-0.02285, 0.02285, 0.0],
            [-0.02285, -0.02285, 0.0],
            [0.02285, -0.02285, 0.0],
        ],
        "channel_map": [1, 2, 3, 4],
    },
    "windows": [
        {
            "t_start": 0.0,
            "t_end": 1.024,
            "num_sources": 1,
            "sources": [
                {
                    "azimuth_deg": 45.2,
                    "confidence": 0.93,
                    "id": 1,
                    "elevation_deg": None,
                    "unit_vector": [0.70463, 0.70957, 0.0],
                }
            ],
        }
    ],
    "summary": {"sources": [{"azimuth_deg": 45.2, "confidence": 0.93, "share": 1.0}]},
    "warnings": [],
}

_BINARY = {"schema": {"type": "string", "format": "binary"}}


def localize_operation() -> dict[str, Any]:
    """Parameters and request bodies of ``POST /localize``."""
    parameters = [
        # None is required: it may be a form field instead.
        {"name": name, "in": "query", "required": False, **_described(option)}
        for name, option in OPTIONS.items()
    ]
    return {"parameters": parameters, "requestBody": _request_body()}


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
