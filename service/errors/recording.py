"""Recordings, arrays and options that cannot be used as they are."""

from __future__ import annotations

from service.errors.base import DoaError


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
