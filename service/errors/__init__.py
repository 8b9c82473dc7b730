"""The one error tree: HTTP problems, command-line messages and their documentation come from it.

DoaError
├─ ConfigError
├─ AudioError
│  ├─ NotAudio · EmptyAudio · TruncatedAudio · NonFiniteAudio · DecodingFailed ·
│  │  RecordingUnreadable
│  ├─ ChannelMismatch · TooManyChannels · UnsupportedSampleRate · AudioTooLong
├─ ArrayError
│  └─ UnknownArray · InvalidGeometry · InvalidChannelMap
├─ OptionError
│  └─ UnknownModel · UnknownMethod · InvalidOption · TooManySources · GeometryMismatch
├─ NoiseError
│  ├─ UnknownNoise · NoiseMismatch · NoiseProfileInvalid · NoiseCalibrationFailed
│  └─ NoiseStoreFull
├─ UploadError
│  └─ MissingAudio · UploadTooLarge · UnsupportedMediaType · RequestTimeout
├─ AccessError
│  ├─ Unauthorized ─ KeyMissing · KeyUnknown · KeyExpired
│  └─ RoleMissing · KeyInAddress · HostRefused · OriginRefused
├─ KeyLimitError
│  └─ TooManyUploads · AudioQuota
├─ StreamProtocolError
│  └─ InvalidMessage · AudioBeforeStart · MessageTooBig · StreamTimeout · SessionLimit ·
│     TooManySessions · SubprotocolMissing
├─ BundleError
│  └─ BundleNotFound · BundleCorrupt · BundleIncompatible · SelfTestFailed · ReloadRefused
└─ CapacityError
   └─ Overloaded · DiskFull · NotReady · Draining · WorkerLost

``service.client.errors`` adds those of the clients.
"""

from __future__ import annotations

from service.errors.access import (
    AccessError,
    AudioQuota,
    HostRefused,
    KeyExpired,
    KeyInAddress,
    KeyLimitError,
    KeyMissing,
    KeyUnknown,
    OriginRefused,
    RoleMissing,
    TooManyUploads,
    Unauthorized,
)
from service.errors.base import UNEXPECTED, ConfigError, DoaError
from service.errors.operation import (
    BundleCorrupt,
    BundleError,
    BundleIncompatible,
    BundleNotFound,
    CapacityError,
    DiskFull,
    Draining,
    NotReady,
    Overloaded,
    ReloadRefused,
    SelfTestFailed,
    WorkerLost,
)
from service.errors.recording import (
    ArrayError,
    AudioError,
    AudioTooLong,
    ChannelMismatch,
    DecodingFailed,
    EmptyAudio,
    GeometryMismatch,
    InvalidChannelMap,
    InvalidGeometry,
    InvalidOption,
    NoiseCalibrationFailed,
    NoiseError,
    NoiseMismatch,
    NoiseProfileInvalid,
    NoiseStoreFull,
    NonFiniteAudio,
    NotAudio,
    OptionError,
    RecordingUnreadable,
    TooManyChannels,
    TooManySources,
    TruncatedAudio,
    UnknownArray,
    UnknownMethod,
    UnknownModel,
    UnknownNoise,
    UnsupportedSampleRate,
)
from service.errors.stream import (
    AudioBeforeStart,
    InvalidMessage,
    MessageTooBig,
    SessionLimit,
    StreamProtocolError,
    StreamTimeout,
    SubprotocolMissing,
    TooManySessions,
)
from service.errors.upload import (
    MissingAudio,
    RequestTimeout,
    UnsupportedMediaType,
    UploadError,
    UploadTooLarge,
)

__all__ = [
    "UNEXPECTED",
    "AccessError",
    "ArrayError",
    "AudioBeforeStart",
    "AudioError",
    "AudioQuota",
    "AudioTooLong",
    "BundleCorrupt",
    "BundleError",
    "BundleIncompatible",
    "BundleNotFound",
    "CapacityError",
    "ChannelMismatch",
    "ConfigError",
    "DecodingFailed",
    "DiskFull",
    "DoaError",
    "Draining",
    "EmptyAudio",
    "GeometryMismatch",
    "HostRefused",
    "InvalidChannelMap",
    "InvalidGeometry",
    "InvalidMessage",
    "InvalidOption",
    "KeyExpired",
    "KeyInAddress",
    "KeyLimitError",
    "KeyMissing",
    "KeyUnknown",
    "MessageTooBig",
    "MissingAudio",
    "NoiseCalibrationFailed",
    "NoiseError",
    "NoiseMismatch",
    "NoiseProfileInvalid",
    "NoiseStoreFull",
    "NonFiniteAudio",
    "NotAudio",
    "NotReady",
    "OptionError",
    "OriginRefused",
    "Overloaded",
    "RecordingUnreadable",
    "ReloadRefused",
    "RequestTimeout",
    "RoleMissing",
    "SelfTestFailed",
    "SessionLimit",
    "StreamProtocolError",
    "StreamTimeout",
    "SubprotocolMissing",
    "TooManyChannels",
    "TooManySessions",
    "TooManySources",
    "TooManyUploads",
    "TruncatedAudio",
    "Unauthorized",
    "UnknownArray",
    "UnknownMethod",
    "UnknownModel",
    "UnknownNoise",
    "UnsupportedMediaType",
    "UnsupportedSampleRate",
    "UploadError",
    "UploadTooLarge",
    "WorkerLost",
]
