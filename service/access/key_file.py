"""The file of API keys: who may do what, without any secret in it.

A token is 256 random bits behind a prefix that secret scanners can look for; the file has its
SHA-256. A slow hash (bcrypt, Argon2) would protect nothing here: it makes guessing dear where
people choose from few passwords, and nobody searches 2^256 tokens. It would only make every
request, right or wrong, cost a tenth of a second.

The file has one JSON object a line; empty lines and lines that begin with ``#`` are ignored::

    {"name": "robot-1", "sha256": "9f86...", "roles": ["stream"], "max_sessions": 2}
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import secrets
import stat
from collections import Counter
from pathlib import Path
from typing import Literal, get_args

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from neuralmusic.errors import ConfigError
from neuralmusic.protocol.names import NAME

log = logging.getLogger(__name__)

Role = Literal["localize", "stream", "watch", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
PREFIX = "nmk_"
TOKEN_BYTES = 32
TOKEN = re.compile(PREFIX + r"[A-Za-z0-9_-]{43}")
MAX_FILE_BYTES = 2**22
HOW = "neuralmusic key new NAME --roles localize,stream"


class Key(BaseModel):
    """One line of the file: a token's hash, its owner's name, its roles and limits."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    name: str = Field(pattern=NAME)
    """Name of the token's owner, for logs"""
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", repr=False)
    """SHA-256 of the token, hexadecimal"""
    roles: tuple[Role, ...] = Field(min_length=1)
    """What the key allows; ``admin`` allows everything"""
    max_sessions: int | None = Field(None, ge=0)
    """Most streams at the same time"""
    max_uploads: int | None = Field(None, ge=0)
    """Most uploads at the same time"""
    audio_seconds_per_hour: float | None = Field(None, gt=0, allow_inf_nan=False)
    """Seconds of audio an hour, in recordings and streams together"""
    origins: tuple[str, ...] = ()
    """Web pages that may use this key, besides the service's own and those of the settings"""
    expires: AwareDatetime | None = None
    """Time at which the key expires"""

    def allows(self, *roles: Role) -> bool:
        """Whether the key has one of the roles, or ``admin``."""
        return "admin" in self.roles or not set(roles).isdisjoint(self.roles)

    @property
    def line(self) -> str:
        """The key as a line of the file."""
        return self.model_dump_json(exclude_defaults=True)


def new_token() -> str:
    """A random token that cannot be guessed."""
    return PREFIX + secrets.token_urlsafe(TOKEN_BYTES)


def token_sha256(token: str) -> str:
    """The hash by which the file knows a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def read_keys(path: Path, *, empty: bool = False) -> tuple[Key, ...]:
    """The keys of a file; with ``empty`` it may hold none.

    Raises
    ------
    ConfigError
        If the file cannot be read, everybody can write to it, or a line is wrong.
    """
    _check_mode(path)
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES + 1).decode("utf-8")
    except OSError as error:
        raise ConfigError(f"keys {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"keys {path} is not a text file: make one with {HOW}") from None
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"keys {path} is larger than {MAX_FILE_BYTES} bytes")
    lines = enumerate((line.strip() for line in text.splitlines()), 1)
    keys = [_read_line(path, number, line) for number, line in lines if line and line[0] != "#"]
    for what, values in (("name", [k.name for k in keys]), ("sha256", [k.sha256 for k in keys])):
        value, times = Counter(values).most_common(1)[0] if values else ("", 0)
        if times > 1:
            raise ConfigError(f"keys {path} has the {what} {value} twice: every key needs its own")
    if not (keys or empty):
        raise ConfigError(f"keys {path} holds no key, so nobody could use the service: {HOW}")
    return tuple(keys)


def _read_line(path: Path, number: int, line: str) -> Key:
    try:
        return Key.model_validate(json.loads(line))
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        said = f"{place}: {first['msg']}" if place else first["msg"]
    except (ValueError, RecursionError):
        said = "it is not a JSON object"
    # The line itself is not shown: somebody may have put a token there.
    raise ConfigError(f"keys {path}, line {number}: {said} (make lines with {HOW})")


def _check_mode(path: Path) -> None:
    """Whoever can write the file can make keys; whoever reads it learns names and roles."""
    if os.name != "posix" or not path.is_file():
        return
    mode = path.stat().st_mode
    if mode & stat.S_IWOTH:
        raise ConfigError(f"keys {path} can be written by everybody: chmod o-w {path}")
    if mode & stat.S_IROTH:
        log.warning("keys %s can be read by everybody: chmod 640 or 600", path)
