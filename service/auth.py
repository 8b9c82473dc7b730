"""API keys: who may do what, from a file that holds no secret.

A token is 256 random bits behind a prefix that secret scanners can look for; the file has its
SHA-256. A slow hash (bcrypt, Argon2) would protect nothing here: it makes guessing dear where
people choose from few passwords, and nobody searches 2^256 tokens. It would make every request,
and every wrong one, cost a tenth of a second instead.

The file has one JSON object a line; empty lines and lines that begin with ``#`` do not count::

    {"name": "robot-1", "sha256": "9f86...", "roles": ["stream"], "max_sessions": 2}
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import os
import re
import secrets
import stat
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, get_args

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from service.errors import ConfigError, KeyExpired, KeyMissing, KeyUnknown, RoleMissing
from service.usage import Usage

log = logging.getLogger(__name__)

Role = Literal["localize", "stream", "watch", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
PREFIX = "nmk_"
TOKEN_BYTES = 32
TOKEN = re.compile(PREFIX + r"[A-Za-z0-9_-]{43}")
MAX_FILE_BYTES = 2**22
HOW = "neuralmusic key new NAME --roles localize,stream"


class Key(BaseModel):
    """One line of the file: whom a token names and what it is good for."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    """Of whoever has the token, for logs"""
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", repr=False)
    """Of the token, hexadecimal"""
    roles: tuple[Role, ...] = Field(min_length=1)
    """What it is good for; ``admin`` is good for everything"""
    max_sessions: int | None = Field(None, ge=0)
    """Streams at the same time"""
    max_uploads: int | None = Field(None, ge=0)
    """Uploads at the same time"""
    audio_seconds_per_hour: float | None = Field(None, gt=0, allow_inf_nan=False)
    """Seconds of audio, in files and streams together"""
    origins: tuple[str, ...] = ()
    """Web pages that may use this key, besides the service's own and those of the settings"""
    expires: AwareDatetime | None = None
    """When it is good no more"""

    def allows(self, *roles: Role) -> bool:
        """Whether it has one of the roles, or is an administrator's."""
        return "admin" in self.roles or not set(roles).isdisjoint(self.roles)

    @property
    def line(self) -> str:
        """The key as a line of the file."""
        return self.model_dump_json(exclude_defaults=True)


ANYONE = Key(name="anyone", sha256="0" * 64, roles=ROLES)
"""Whoever asks a service without keys: everything is allowed"""


def new_token() -> str:
    """A token that nobody guesses."""
    return PREFIX + secrets.token_urlsafe(TOKEN_BYTES)


def token_sha256(token: str) -> str:
    """What the file holds of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def read_keys(path: Path) -> tuple[Key, ...]:
    """The keys of a file.

    Raises
    ------
    ConfigError
        If the file cannot be read, everybody may write to it, or a line is wrong.
    """
    _check_mode(path)
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1).decode("utf-8")
    except OSError as error:
        raise ConfigError(f"keys {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"keys {path} is no text file: make one with {HOW}") from None
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"keys {path} is larger than {MAX_FILE_BYTES} bytes")
    lines = enumerate((line.strip() for line in text.splitlines()), 1)
    keys = [_read_line(path, number, line) for number, line in lines if line and line[0] != "#"]
    for what, values in (("name", [k.name for k in keys]), ("sha256", [k.sha256 for k in keys])):
        value, times = Counter(values).most_common(1)[0] if values else ("", 0)
        if times > 1:
            raise ConfigError(f"keys {path} has the {what} {value} twice: every key has its own")
    if not keys:
        raise ConfigError(f"keys {path} holds no key, so nobody could ask anything: {HOW}")
    return tuple(keys)


def _read_line(path: Path, number: int, line: str) -> Key:
    try:
        return Key.model_validate(json.loads(line))
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        said = f"{place}: {first['msg']}" if place else first["msg"]
    except (ValueError, RecursionError):
        said = "it is no JSON object"
    # The line itself is not shown: somebody may have put a token there.
    raise ConfigError(f"keys {path}, line {number}: {said} (make lines with {HOW})")


def _check_mode(path: Path) -> None:
    """Whoever can write the file can make keys; reading it gives names and roles away."""
    if os.name != "posix" or not path.is_file():
        return
    mode = path.stat().st_mode
    if mode & stat.S_IWOTH:
        raise ConfigError(f"keys {path} can be written by everybody: chmod o-w {path}")
    if mode & stat.S_IROTH:
        log.warning("keys %s can be read by everybody: chmod 640 or 600", path)


class Keys:
    """The keys of a service, and what each of them uses; without a file everything is open.

    Parameters
    ----------
    path : Path, optional
        Of the file.
    clock : callable
        Seconds of a monotonic clock, for the seconds of audio.
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
        """Read the file anew; a wrong one raises ConfigError and leaves the keys as they were.

        Streams of a key that is gone, has expired or lost its role end within a second.
        """
        if self._path is None:
            return
        self._keys = read_keys(self._path)
        names = {key.name for key in self._keys}
        for name, usage in tuple(self._usage.items()):
            if name not in names and not usage.sessions and not usage.uploads:
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
            If it is good for that no more.
        """
        current = self._valid(key.sha256) if self.needed else ANYONE
        if not current.allows(*roles):
            raise RoleMissing(
                f"the key {current.name} is good for {', '.join(current.roles)}; this needs "
                f"{' or '.join(roles)}"
            )
        return current

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

    def charge(self, key: Key, seconds: float) -> None:
        """Count seconds of audio of this key; any thread may."""
        self._used(key).charge(seconds, key.audio_seconds_per_hour)

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
            raise KeyExpired(f"the key {key.name} was good until {key.expires:%Y-%m-%d %H:%M %Z}")
        return key


def matching(keys: Sequence[Key], sha256: str) -> Key | None:
    """The key of this hash; the time tells neither which it is nor how much of it was right."""
    found = None
    for key in keys:  # to the end, whatever was found
        if hmac.compare_digest(key.sha256, sha256):
            found = key
    return found
