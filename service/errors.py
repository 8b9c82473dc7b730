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

UNEXPECTED = "the service failed; its log says why: please report it"
"""Of errors that nobody foresaw; their cause stays in the log"""


class DoaError(Exception):
    """Anything the service can say no to: a stable code, an HTTP status and a sentence.

    A stream that ends with it closes with ``close_code`` (``service.protocol.close_codes``).
    """

    code: str = "internal"
    status: int = 500
    title: str = "Internal error"
    retryable: bool = False
    close_code: int = 1011
    retry_after_s: float | None = None
    """Seconds after which the same request passes, where that is known"""

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class ConfigError(DoaError):
    """A setting is unknown or out of range; the service does not start."""

    code, title = "config_invalid", "Invalid configuration"


class AudioError(DoaError):
    """The recording cannot be used as it is."""

    code, status, title = "audio_invalid", 422, "Unusable audio"
    close_code = 4400


class NotAudio(AudioError):
    """The bytes are no audio file that libsndfile reads."""

    code, status, title = "not_audio", 415, "Not an audio file"


class EmptyAudio(AudioError):
    """The file holds no sample frames."""

    code, title = "audio_empty", "Empty recording"


class TruncatedAudio(AudioError):
    """The header promises more audio than the file holds."""

    code, title = "audio_truncated", "Truncated recording"


class NonFiniteAudio(AudioError):
    """Samples are NaN, infinite or absurdly large."""

    code, title = "audio_non_finite", "Non-finite samples"


class DecodingFailed(AudioError):
    """The recording crashed its decoder, or kept it from ever getting on."""

    code, title = "decoding_failed", "Decoding failed"


class RecordingUnreadable(AudioError):
    """The file of a recording cannot be opened where it is to be localized."""

    code, title = "recording_unreadable", "Unreadable recording"


class ChannelMismatch(AudioError):
    """The recording's channels do not fit the array or the channel map."""

    code, title = "channel_mismatch", "Channels do not fit the array"


class TooManyChannels(AudioError):
    """The recording has more channels than the service accepts."""

    code, title = "too_many_channels", "Too many channels"


class UnsupportedSampleRate(AudioError):
    """The sample rate is outside of what can be localized."""

    code, title = "sample_rate_unsupported", "Unsupported sample rate"


class AudioTooLong(AudioError):
    """The recording is longer than the service accepts."""

    code, status, title = "audio_too_long", 413, "Recording too long"


class ArrayError(DoaError):
    """The microphone array is unknown or makes no sense."""

    code, status, title = "array_invalid", 422, "Invalid microphone array"
    close_code = 4400


class UnknownArray(ArrayError):
    """No preset has this name."""

    code, title = "array_unknown", "Unknown array"


class InvalidGeometry(ArrayError):
    """The microphone positions cannot be those of one small array in metres."""

    code, title = "geometry_invalid", "Invalid array geometry"


class InvalidChannelMap(ArrayError):
    """The channel map does not name one distinct channel per microphone."""

    code, title = "channel_map_invalid", "Invalid channel map"


class OptionError(DoaError):
    """An option of the request is wrong."""

    code, status, title = "option_invalid", 422, "Invalid option"
    close_code = 4400


class InvalidOption(OptionError):
    """An option is unknown, unreadable or out of range."""


class UnknownModel(OptionError):
    """No loaded bundle has this name."""

    code, title = "model_unknown", "Unknown model"


class UnknownMethod(OptionError):
    """No localization method has this name."""

    code, title = "method_unknown", "Unknown method"


class TooManySources(OptionError):
    """More sources are asked for than the array can tell apart."""

    code, title = "too_many_sources", "Too many sources for the array"


class GeometryMismatch(OptionError):
    """The named bundle is bound to another array."""

    code, title = "geometry_mismatch", "The model is bound to another array"


class NoiseError(DoaError):
    """A profile of the robot's own noise cannot be learnt, stored or used."""

    code, status, title = "noise_error", 422, "Unusable noise profile"


class UnknownNoise(NoiseError):
    """No noise profile is stored under this name."""

    code, title = "noise_unknown", "Unknown noise profile"


class NoiseMismatch(NoiseError):
    """The noise profile was learnt with another array or other frames."""

    code, title = "noise_mismatch", "The noise profile does not fit"


class NoiseProfileInvalid(NoiseError):
    """The bytes are no noise profile that this version reads."""

    code, title = "noise_invalid", "Invalid noise profile"


class NoiseCalibrationFailed(NoiseError):
    """There is too little or no noise to learn a profile from."""

    code, title = "noise_calibration_failed", "Noise calibration failed"


class NoiseStoreFull(NoiseError):
    """The service holds as many noise profiles as it keeps."""

    code, status, title = "noise_full", 409, "Too many noise profiles"


class UploadError(DoaError):
    """The request's body cannot be taken."""

    code, status, title = "upload_invalid", 400, "Invalid upload"


class MissingAudio(UploadError):
    """The request holds no recording."""

    code, status, title = "audio_missing", 422, "No recording in the request"


class UploadTooLarge(UploadError):
    """The body is larger than the service accepts."""

    code, status, title = "upload_too_large", 413, "Upload too large"


class UnsupportedMediaType(UploadError):
    """The body's content type is neither a form nor audio."""

    code, status, title = "media_type_unsupported", 415, "Unsupported media type"


class RequestTimeout(UploadError):
    """The request came too slowly."""

    code, status, title = "request_timeout", 408, "Request timeout"


class AccessError(DoaError):
    """Whoever asks may not have this."""

    code, status, title = "access_refused", 403, "Access refused"
    close_code = 4401


class Unauthorized(AccessError):
    """The request has no key that is good here; answered with ``WWW-Authenticate``."""

    code, status, title = "unauthorized", 401, "Key needed"


class KeyMissing(Unauthorized):
    """The service asks for a key, and the request has none."""

    code, title = "key_missing", "Key missing"


class KeyUnknown(Unauthorized):
    """The service has no such key, or has it no more."""

    code, title = "key_unknown", "Unknown key"


class KeyExpired(Unauthorized):
    """The key was valid until a date that has passed."""

    code, title = "key_expired", "Key expired"


class RoleMissing(AccessError):
    """The key is good, but not for this."""

    code, title = "role_missing", "Role missing"


class KeyInAddress(AccessError):
    """A key was sent in the query, where logs and histories keep it."""

    code, status, title = "key_in_address", 400, "Key in the address"


class HostRefused(AccessError):
    """The request names a host that this service is not."""

    code, status, title = "host_refused", 421, "Unknown host"


class OriginRefused(AccessError):
    """A web page of this origin may not use the service."""

    code, title, close_code = "origin_refused", "Origin refused", 1008


class KeyLimitError(DoaError):
    """The key has used what it may."""

    code, status, title = "key_limit", 429, "Limit of the key reached"
    close_code = 4429


class TooManyUploads(KeyLimitError):
    """As many uploads of this key are in work as it may have at a time."""

    code, title = "too_many_uploads", "Too many uploads"


class AudioQuota(KeyLimitError):
    """The key has used its seconds of audio for now."""

    code, title = "audio_quota", "Audio quota used up"

    def __init__(self, detail: str, retry_after_s: float) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s


class StreamProtocolError(DoaError):
    """A stream's client broke the protocol, or the session met one of its limits."""

    code, status, title = "stream_invalid", 400, "Invalid stream"
    close_code = 4400


class InvalidMessage(StreamProtocolError):
    """A message is no JSON, of no known type, or one of its fields is wrong."""

    code, title = "message_invalid", "Invalid message"


class SubprotocolMissing(StreamProtocolError):
    """The WebSocket's client did not offer the subprotocol ``doa.v1``."""

    code, title = "subprotocol_missing", "Subprotocol missing"


class AudioBeforeStart(StreamProtocolError):
    """Audio came before the message ``start``."""

    code, title, close_code = "audio_before_start", "Audio before start", 1003


class MessageTooBig(StreamProtocolError):
    """A message is larger than 64 KiB."""

    code, title, close_code = "message_too_big", "Message too big", 1009


class StreamTimeout(StreamProtocolError):
    """Nothing came, or nothing was read, for too long."""

    code, title, close_code = "timeout", "Timeout", 4408


class SessionLimit(StreamProtocolError):
    """The session reached its longest duration."""

    code, title, close_code = "session_limit", "Session limit", 4410


class TooManySessions(StreamProtocolError):
    """This client, or this key, has as many sessions as it may have."""

    code, status, title, close_code = "too_many_sessions", 429, "Too many sessions", 4429


class BundleError(DoaError):
    """A model bundle cannot be used."""

    code, title = "bundle_invalid", "Unusable model bundle"


class BundleNotFound(BundleError):
    """There is no bundle at that place."""

    code, title = "bundle_not_found", "Model bundle not found"


class BundleCorrupt(BundleError):
    """A file of the bundle is missing or its hash differs from the manifest's."""

    code, title = "bundle_corrupt", "Corrupt model bundle"


class BundleIncompatible(BundleError):
    """The bundle was written for another version of this service."""

    code, title = "bundle_incompatible", "Incompatible model bundle"


class SelfTestFailed(BundleError):
    """The bundle's golden input does not give the golden output on this machine."""

    code, title = "self_test_failed", "Model self-test failed"


class ReloadRefused(BundleError):
    """The bundles on disk cannot be used; those that were loaded go on serving."""

    code, status, title = "reload_refused", 409, "Reload refused"


class CapacityError(DoaError):
    """The service is full; the same request may pass later."""

    code, status, title, retryable = "capacity", 503, "Out of capacity", True
    close_code = 1013


class Overloaded(CapacityError):
    """Every worker is busy and the queue is full."""

    code, title = "overloaded", "Overloaded"


class DiskFull(CapacityError):
    """What a client sent cannot be stored: the disk is full or refuses to be written."""

    code, title = "disk_full", "Disk full"


class NotReady(CapacityError):
    """The models are not loaded yet."""

    code, title = "not_ready", "Not ready"


class Draining(CapacityError):
    """The service is shutting down."""

    code, title = "draining", "Shutting down"
    close_code = 1012


class WorkerLost(CapacityError):
    """The process that computed a stream or localized a recording ended."""

    code, title = "worker_lost", "Worker lost"
    close_code = 1011
