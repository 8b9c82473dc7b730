"""API keys: whose a token is, what it allows, and how much of it.

Wrong tokens are not throttled: nobody searches 2^256 tokens, and behind a proxy, where all clients
share one address, one attacker would lock everybody out.
"""

from __future__ import annotations

import hmac
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from neuralmusic.errors import AccessError, KeyExpired, KeyMissing, KeyUnknown, RoleMissing
from service.access.key_file import ROLES, Key, Role, read_keys, token_sha256
from service.access.usage import Usage

MAX_WATCHERS = 64
"""Most watchers of streams with one key, or without keys"""

ANYONE = Key(name="anyone", sha256="0" * 64, roles=ROLES)
"""Stands for every client of a service without keys; everything is allowed"""


class Keys:
    """The keys of a service and what each of them uses; without a file everything is open.

    Parameters
    ----------
    path : Path, optional
        The file of keys.
    clock : callable
        Seconds of a monotonic clock, for the limit of audio an hour.
    today : callable
        The time in UTC, for dates of expiry.

    Raises
    ------
    ConfigError
        If the file cannot be used.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        today: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._path = path
        self._clock = clock
        self._today = today
        self._keys: tuple[Key, ...] = () if path is None else read_keys(path)
        self._usage: dict[str, Usage] = {}

    @property
    def needed(self) -> bool:
        """False where no keys are configured."""
        return self._path is not None

    def reload(self) -> None:
        """Read the file again; a wrong one raises ConfigError and leaves the keys as they were.

        Streams of a key that is gone, has expired or lost its role end within a second.
        """
        if self._path is None:
            return
        self._keys = read_keys(self._path)
        names = {key.name for key in self._keys}
        for name, usage in tuple(self._usage.items()):
            if name not in names and usage.idle:
                del self._usage[name]

    def authenticate(self, token: str | None) -> Key:
        """The key of a token.

        Raises
        ------
        KeyMissing, KeyUnknown, KeyExpired
            If there is no valid one.
        """
        if not self.needed:
            return ANYONE
        if not token:
            raise KeyMissing(
                "this service asks for a key: send it as the header Authorization: Bearer KEY, or "
                "from a web page as the WebSocket subprotocol bearer.BASE64URL(KEY)"
            )
        return self._valid(token_sha256(token))

    def check(self, key: Key, *roles: Role) -> Key:
        """The key as it is now, with one of the roles.

        Raises
        ------
        KeyUnknown, KeyExpired, RoleMissing
            If the key no longer allows it.
        """
        current = self._valid(key.sha256) if self.needed else ANYONE
        if not current.allows(*roles):
            raise RoleMissing(
                f"this needs the role {' or '.join(roles)}; the key {current.name} has "
                f"{', '.join(current.roles)}"
            )
        return current

    def holds(self, key: Key, *roles: Role) -> bool:
        """Whether ``check`` would let the key pass."""
        try:
            self.check(key, *roles)
        except AccessError:
            return False
        return True

    @contextmanager
    def session(self, key: Key) -> Iterator[None]:
        """Hold a place for a stream of this key, or raise TooManySessions or AudioQuota."""
        self.check_audio(key)
        with self._used(key).session(key.max_sessions):
            yield

    @contextmanager
    def upload(self, key: Key) -> Iterator[None]:
        """Hold a place for an upload of this key, or raise TooManyUploads or AudioQuota."""
        self.check_audio(key)
        with self._used(key).upload(key.max_uploads):
            yield

    @contextmanager
    def watcher(self, key: Key) -> Iterator[None]:
        """Hold a place for a watcher with this key, or raise TooManyWatchers."""
        with self._used(key).watcher(MAX_WATCHERS):
            yield

    def charge(self, key: Key, seconds: float) -> None:
        """Count seconds of audio of this key; safe to call from any thread."""
        self._used(key).charge(seconds, key.audio_seconds_per_hour)

    def reserve(self, key: Key, seconds: float) -> None:
        """Count seconds of audio to come, or raise AudioQuota or AudioTooLong.

        Negative ones are given back.
        """
        self._used(key).reserve(seconds, key.audio_seconds_per_hour)

    def check_audio(self, key: Key) -> None:
        """Raise AudioQuota where the key's seconds of audio are used up."""
        self._used(key).check_audio(key.audio_seconds_per_hour)

    def _used(self, key: Key) -> Usage:
        usage = self._usage.get(key.name)
        return usage or self._usage.setdefault(key.name, Usage(self._clock))

    def _valid(self, sha256: str) -> Key:
        key = matching(self._keys, sha256)
        if key is None:
            raise KeyUnknown("the service has no such key: check it, or ask for a new one")
        if key.expires is not None and key.expires <= self._today():
            raise KeyExpired(f"the key {key.name} expired on {key.expires:%Y-%m-%d %H:%M %Z}")
        return key


def matching(keys: Sequence[Key], sha256: str) -> Key | None:
    """The key with this hash, compared in constant time."""
    found = None
    for key in keys:  # to the end, so that the time does not tell which one it is
        if hmac.compare_digest(key.sha256, sha256):
            found = key
    return found
