"""Requests whose body cannot be taken."""

from __future__ import annotations

from service.errors.base import DoaError


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
