"""The one error tree: HTTP problems, command-line messages and their documentation come from it.

DoaError
├─ ConfigError
├─ AudioError
│  ├─ NotAudio · EmptyAudio · TruncatedAudio · NonFiniteAudio · DecodingFailed · AudioTooLong
│  └─ RecordingUnreadable · ChannelMismatch · TooManyChannels · UnsupportedSampleRate
├─ ArrayError
│  └─ UnknownArray · InvalidGeometry · InvalidChannelMap
├─ OptionError
│  └─ UnknownModel · UnknownMethod · InvalidOption · TooManySources · GeometryMismatch
├─ NoiseError
│  └─ UnknownNoise · NoiseMismatch · NoiseProfileInvalid · NoiseCalibrationFailed · NoiseStoreFull
├─ UploadError
│  └─ MissingAudio · UploadTooLarge · UnsupportedMediaType · RequestTimeout
├─ AccessError
│  ├─ Unauthorized ─ KeyMissing · KeyUnknown · KeyExpired
│  └─ RoleMissing · KeyInAddress · HostRefused · OriginRefused
├─ KeyLimitError
│  └─ TooManyUploads · TooManyWatchers · AudioQuota
├─ StreamProtocolError
│  └─ InvalidMessage · AudioBeforeStart · MessageTooBig · StreamTimeout · SessionLimit ·
│     TooManySessions · TooManyFrames · SubprotocolMissing
├─ BundleError
│  └─ BundleNotFound · BundleCorrupt · BundleIncompatible · SelfTestFailed · ReloadRefused
└─ CapacityError
   └─ Overloaded · TooManyConnections · DiskFull · NotReady · Draining · TooSlow · WorkerLost

``neuralmusic.client_errors`` adds those that clients raise themselves.
"""

from __future__ import annotations

from typing import TypedDict

from typing_extensions import Unpack

UNEXPECTED = "the service failed; its log says why: please report it"
"""Sentence for unexpected errors; their cause stays in the log"""


def printable(text: str) -> str:
    """``text`` with what begins lines, moves cursors or is no character written out."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


class Attributes(TypedDict, total=False):
    """Keywords of the class statement of an error."""

    code: str
    status: int
    title: str
    retryable: bool
    close_code: int


class DoaError(Exception):
    """Any refusal or failure: a stable code, an HTTP status, a stream's close code, a sentence."""

    code: str = "internal"
    status: int = 500
    title: str = "Internal error"
    retryable: bool = False
    close_code: int = 1011
    retry_after_s: float | None = None
    """Seconds after which the same request may pass, where that is known"""

    def __init_subclass__(cls, **attributes: Unpack[Attributes]) -> None:
        """Take attributes from keywords of the class statement; others are inherited."""
        super().__init_subclass__()
        for name, value in attributes.items():
            setattr(cls, name, value)

    def __init__(self, detail: str) -> None:
        self.detail = printable(detail)  # sentences repeat paths and what libraries say
        super().__init__(self.detail)


class ConfigError(DoaError, code="config_invalid", title="Invalid configuration"):
    """A setting is unknown or out of range; the service does not start."""


class AudioError(
    DoaError, code="audio_invalid", status=422, title="Unusable audio", close_code=4400
):
    """The recording cannot be used as it is."""


class NotAudio(AudioError, code="not_audio", status=415, title="Not an audio file"):
    """The bytes are no audio file that libsndfile reads."""


class EmptyAudio(AudioError, code="audio_empty", title="Empty recording"):
    """The file holds no sample frames."""


class TruncatedAudio(AudioError, code="audio_truncated", title="Truncated recording"):
    """The header promises more audio than the file holds."""


class NonFiniteAudio(AudioError, code="audio_non_finite", title="Non-finite samples"):
    """Samples are NaN, infinite or absurdly large."""


class DecodingFailed(AudioError, code="decoding_failed", title="Decoding failed"):
    """The recording crashed its decoder, or the decoder made no progress."""


class RecordingUnreadable(AudioError, code="recording_unreadable", title="Unreadable recording"):
    """The file of a recording cannot be opened where it is to be localized."""


class ChannelMismatch(AudioError, code="channel_mismatch", title="Channels do not fit the array"):
    """The recording's channels do not fit the array or the channel map."""


class TooManyChannels(AudioError, code="too_many_channels", title="Too many channels"):
    """The recording has more channels than the service accepts."""


class UnsupportedSampleRate(
    AudioError, code="sample_rate_unsupported", title="Unsupported sample rate"
):
    """The sample rate is outside the range that can be localized."""


class AudioTooLong(AudioError, code="audio_too_long", status=413, title="Recording too long"):
    """The recording is longer than the service accepts."""


class ArrayError(
    DoaError, code="array_invalid", status=422, title="Invalid microphone array", close_code=4400
):
    """The microphone array is unknown or makes no sense."""


class UnknownArray(ArrayError, code="array_unknown", title="Unknown array"):
    """No preset has this name."""


class InvalidGeometry(ArrayError, code="geometry_invalid", title="Invalid array geometry"):
    """The microphone positions cannot be those of one small array in metres."""


class InvalidChannelMap(ArrayError, code="channel_map_invalid", title="Invalid channel map"):
    """The channel map does not name one distinct channel per microphone."""


class OptionError(
    DoaError, code="option_invalid", status=422, title="Invalid option", close_code=4400
):
    """An option of the request is wrong."""


class InvalidOption(OptionError):
    """An option is unknown, unreadable or out of range."""


class UnknownModel(OptionError, code="model_unknown", title="Unknown model"):
    """No loaded bundle has this name."""


class UnknownMethod(OptionError, code="method_unknown", title="Unknown method"):
    """No localization method has this name."""


class TooManySources(OptionError, code="too_many_sources", title="Too many sources for the array"):
    """More sources are requested than the array can tell apart."""


class GeometryMismatch(
    OptionError, code="geometry_mismatch", title="The model is bound to another array"
):
    """The named bundle is bound to another array."""


class NoiseError(DoaError, code="noise_error", status=422, title="Unusable noise profile"):
    """A profile of the robot's own noise cannot be learnt, stored or used."""


class UnknownNoise(NoiseError, code="noise_unknown", title="Unknown noise profile"):
    """No noise profile is stored under this name."""


class NoiseMismatch(NoiseError, code="noise_mismatch", title="The noise profile does not fit"):
    """The noise profile was learnt with another array or other frames."""


class NoiseProfileInvalid(NoiseError, code="noise_invalid", title="Invalid noise profile"):
    """The bytes are no noise profile that this version reads."""


class NoiseCalibrationFailed(
    NoiseError, code="noise_calibration_failed", title="Noise calibration failed"
):
    """There is too little or no noise to learn a profile from."""


class NoiseStoreFull(NoiseError, code="noise_full", status=409, title="Too many noise profiles"):
    """The limit of stored noise profiles is reached."""


class UploadError(DoaError, code="upload_invalid", status=400, title="Invalid upload"):
    """The request's body cannot be accepted."""


class MissingAudio(
    UploadError, code="audio_missing", status=422, title="No recording in the request"
):
    """The request holds no recording."""


class UploadTooLarge(UploadError, code="upload_too_large", status=413, title="Upload too large"):
    """The body is larger than the service accepts."""


class UnsupportedMediaType(
    UploadError, code="media_type_unsupported", status=415, title="Unsupported media type"
):
    """The body's content type is neither a form nor audio."""


class RequestTimeout(UploadError, code="request_timeout", status=408, title="Request timeout"):
    """The request came too slowly."""


class AccessError(
    DoaError, code="access_refused", status=403, title="Access refused", close_code=4401
):
    """The client has no access to this."""


class Unauthorized(AccessError, code="unauthorized", status=401, title="Key needed"):
    """The request has no valid key; the answer has ``WWW-Authenticate``."""


class KeyMissing(Unauthorized, code="key_missing", title="Key missing"):
    """The service asks for a key, and the request has none."""


class KeyUnknown(Unauthorized, code="key_unknown", title="Unknown key"):
    """The service has no such key, or it was removed."""


class KeyExpired(Unauthorized, code="key_expired", title="Key expired"):
    """The key has expired."""


class RoleMissing(AccessError, code="role_missing", title="Role missing"):
    """The key is valid, but lacks the role for this."""


class KeyInAddress(AccessError, code="key_in_address", status=400, title="Key in the address"):
    """A key was sent in the query, where logs and histories keep it."""


class HostRefused(AccessError, code="host_refused", status=421, title="Unknown host"):
    """The request's host is not a name of this service."""


class OriginRefused(AccessError, code="origin_refused", title="Origin refused", close_code=1008):
    """A web page of this origin may not use the service."""


class KeyLimitError(
    DoaError, code="key_limit", status=429, title="Limit of the key reached", close_code=4429
):
    """The key has reached one of its limits."""


class TooManyUploads(KeyLimitError, code="too_many_uploads", title="Too many uploads"):
    """The key has reached its limit of uploads at the same time."""


class TooManyWatchers(KeyLimitError, code="too_many_watchers", title="Too many watchers"):
    """The key watches its most streams at the same time."""


class AudioQuota(KeyLimitError, code="audio_quota", title="Audio quota used up"):
    """The key has used its seconds of audio for now."""

    def __init__(self, detail: str, retry_after_s: float) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s


class StreamProtocolError(
    DoaError, code="stream_invalid", status=400, title="Invalid stream", close_code=4400
):
    """A stream's client broke the protocol, or the session reached one of its limits."""


class InvalidMessage(StreamProtocolError, code="message_invalid", title="Invalid message"):
    """A message is not JSON, has no known type, or one of its fields is wrong."""


class SubprotocolMissing(
    StreamProtocolError, code="subprotocol_missing", title="Subprotocol missing"
):
    """The WebSocket's client did not offer the subprotocol ``doa.v1``."""


class AudioBeforeStart(
    StreamProtocolError, code="audio_before_start", title="Audio before start", close_code=1003
):
    """Audio came before the message ``start``."""


class MessageTooBig(
    StreamProtocolError, code="message_too_big", title="Message too big", close_code=1009
):
    """A message is larger than 256 KiB, or a text longer than 64 KiB."""


class StreamTimeout(StreamProtocolError, code="timeout", title="Timeout", close_code=4408):
    """Nothing came, or nothing was read, for too long."""


class SessionLimit(
    StreamProtocolError, code="session_limit", title="Session limit", close_code=4410
):
    """The session reached its longest duration."""


class TooManySessions(
    StreamProtocolError,
    code="too_many_sessions",
    status=429,
    title="Too many sessions",
    close_code=4429,
):
    """This client, or this key, has reached its limit of sessions."""


class TooManyFrames(
    StreamProtocolError, code="too_many_frames", title="Too many frames", close_code=1008
):
    """The client sent hardly any messages, but many pings, pongs or small fragments."""


class BundleError(DoaError, code="bundle_invalid", title="Unusable model bundle"):
    """A model bundle cannot be used."""


class BundleNotFound(BundleError, code="bundle_not_found", title="Model bundle not found"):
    """There is no bundle in that folder."""


class BundleCorrupt(BundleError, code="bundle_corrupt", title="Corrupt model bundle"):
    """A file of the bundle is missing or its hash differs from the manifest's."""


class BundleIncompatible(
    BundleError, code="bundle_incompatible", title="Incompatible model bundle"
):
    """The bundle was written for another version of this service."""


class SelfTestFailed(BundleError, code="self_test_failed", title="Model self-test failed"):
    """The bundle's golden input does not give the golden output on this machine."""


class ReloadRefused(BundleError, code="reload_refused", status=409, title="Reload refused"):
    """The bundles on disk cannot be used; the service keeps the loaded ones."""


class CapacityError(
    DoaError, code="capacity", status=503, title="Out of capacity", retryable=True, close_code=1013
):
    """The service is full; the same request may pass later."""


class Overloaded(CapacityError, code="overloaded", title="Overloaded"):
    """Every worker is busy and the queue is full, or the limit of streams is reached."""


class TooManyConnections(CapacityError, code="too_many_connections", title="Too many connections"):
    """The service has as many connections, or files open, as it may."""


class DiskFull(CapacityError, code="disk_full", title="Disk full"):
    """The client's data cannot be stored: the disk is full or cannot be written."""


class NotReady(CapacityError, code="not_ready", title="Not ready"):
    """The models are not loaded yet."""


class Draining(CapacityError, code="draining", title="Shutting down", close_code=1012):
    """The service is shutting down."""


class TooSlow(CapacityError, code="too_slow", title="Too slow"):
    """Localizing the recording took longer than the recording lasts, and was stopped."""


class WorkerLost(CapacityError, code="worker_lost", title="Worker lost", close_code=1011):
    """The process that computed a stream or localized a recording ended."""
