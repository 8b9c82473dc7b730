"""Who may not, and who has had enough."""

from __future__ import annotations

from service.errors.base import DoaError


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
