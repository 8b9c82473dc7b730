"""Every setting of the service: its unit, its default, its environment variable.

A flag wins over the environment (``NEURALMUSIC_PORT`` for ``port``), which wins over the default.
A name ends with its unit where it has one: ``_s``, ``_seconds``, ``_bytes``. Names that end with
``workers`` size a pool of processes; ``processes`` share the work of one recording.
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from neuralmusic.errors import ConfigError
from service.access.key_file import TOKEN
from service.machine.cpus import usable_cpus

PREFIX = "NEURALMUSIC_"
KEY_VARIABLE = f"{PREFIX}KEY"
"""Variable with the key that a client sends; it is not a setting of the service"""

GRACE = 10.0
"""Default seconds for running recordings to finish after SIGTERM"""

RENAMED = {
    "threads": "processes",
    "stall_timeout": "stall_timeout_s",
    "body_timeout": "body_timeout_s",
    "stream_buffer": "stream_buffer_s",
    "idle_timeout": "idle_timeout_s",
    "max_session": "max_session_s",
    "drain_delay": "drain_delay_s",
    "drain_grace": "drain_grace_s",
}
"""Former names of settings; a setting with one is refused with its new name"""

LogLevel = Literal["critical", "error", "warning", "info", "debug"]
IPNetwork = ipaddress.IPv4Network | ipaddress.IPv6Network
LogFormat = Literal["text", "json"]
Peer = tuple[str, int]


class Settings(BaseSettings):
    """How one process of the service runs."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX,
        env_ignore_empty=True,
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
    )

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 or :: for all addresses"""
    port: int = Field(8000, ge=0, le=65535)
    """TCP port; 0 takes a free one"""
    models: Annotated[tuple[Path, ...], NoDecode] = ()
    """Folders of further model bundles, separated as in PATH"""
    default_model: str | None = None
    """Model for requests that name none, if it fits their array; otherwise the first that fits"""
    workers: int = Field(default_factory=usable_cpus, ge=1, le=256)
    """Processes that localize recordings, one each at a time; by default the usable CPUs"""
    processes: int = Field(default_factory=usable_cpus, ge=1, le=64)
    """Processes that compute the windows of one recording; by default the usable CPUs"""
    queue: int = Field(16, ge=0, le=10_000)
    """Most recordings that wait for a worker; further ones get 503"""
    stall_timeout_s: float = Field(60.0, ge=1, le=3600)
    """Seconds without progress after which the worker of a recording is stopped"""
    max_upload_bytes: int = Field(512 * 2**20, ge=1024)
    """Largest request body in bytes"""
    body_timeout_s: float = Field(30.0, gt=0, le=86_400)
    """Seconds that a request's body may fall behind 500 bytes a second, silence included"""
    max_seconds: float = Field(3600.0, gt=0, le=86_400)
    """Longest recording in seconds"""
    max_channels: int = Field(64, ge=2, le=1024)
    """Most channels of a recording"""
    max_sessions: int = Field(64, ge=0, le=100_000)
    """Most streams at the same time; further ones get 503"""
    max_sessions_per_client: int = Field(8, ge=1, le=100_000)
    """Most streams of one client name at the same time"""
    stream_workers: int = Field(default_factory=usable_cpus, ge=1, le=256)
    """Most processes that compute streams, several each, started as streams come; by default the
    usable CPUs"""
    stream_frames_per_s: int = Field(500, ge=20, le=1_000_000)
    """WebSocket frames read of one stream each second; a faster client waits, and one that sends
    more than a tenth of it in pings, pongs and small fragments is disconnected"""
    stream_bytes_per_s: int = Field(32 * 2**20, ge=2**16)
    """Bytes read of one stream each second; a faster client waits"""
    max_connections: int = Field(4096, ge=8, le=1_000_000)
    """Most connections, and at most half of the files that may be open; idle ones make room, then
    further ones get 503"""
    max_connections_per_address: int = Field(1024, ge=1, le=1_000_000)
    """Most connections of one address (IPv6: a /64), at most half of all; proxies may have all"""
    proxies: Annotated[tuple[IPNetwork, ...], NoDecode] = ()
    """Addresses or networks of proxies whose X-Forwarded-For is believed, by commas; * for all"""
    peers: Annotated[tuple[Peer, ...], NoDecode] = ()
    """HOST:PORT of the service's replicas, by commas; a name stands for every address it has.
    /sessions then covers them all"""
    stream_buffer_s: float = Field(0.5, ge=0.05, le=60)
    """Most seconds of a stream's audio that wait; older audio is dropped"""
    idle_timeout_s: float = Field(30.0, gt=0, le=86_400)
    """Seconds without any message after which a stream ends"""
    max_session_s: float = Field(86_400.0, gt=0)
    """Longest stream in seconds"""
    origins: Annotated[tuple[str, ...], NoDecode] = ()
    """Origins of web pages that may use the service besides its own, separated by commas; * for
    all"""
    hosts: Annotated[tuple[str, ...], NoDecode] = ()
    """Host names that requests may use, separated by commas, * for any; by default any, but on
    loopback without keys only localhost, names without a dot and addresses"""
    keys: Path | None = None
    """File of the API keys (neuralmusic key new); without it everybody may do everything"""
    noise_folder: Path | None = None
    """Folder that keeps noise profiles across restarts; without it they are kept in memory"""
    drain_delay_s: float = Field(0.0, ge=0, le=3600)
    """Seconds after SIGTERM in which /readyz is 503 but new work is still accepted, until proxies
    have noticed"""
    drain_grace_s: float = Field(GRACE, ge=0, le=86_400)
    """Seconds that running recordings then get to finish"""
    log_level: LogLevel = "info"
    """Least severe messages that are logged: critical, error, warning, info or debug"""
    log_format: LogFormat = "text"
    """Format of the log: text for people, or json, one object a line"""
    traces: str | None = None
    """OTLP/HTTP endpoint that gets traces, such as http://collector:4318; needs the extra otel"""

    @field_validator("models", mode="before")
    @classmethod
    def _split_path(cls, value: object) -> object:
        return tuple(filter(None, value.split(os.pathsep))) if isinstance(value, str) else value

    @field_validator("origins", "hosts", mode="before")
    @classmethod
    def _split_commas(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        return tuple(part.strip() for part in value.split(",") if part.strip())

    @field_validator("proxies", mode="before")
    @classmethod
    def _read_networks(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        listed = value.replace("*", "0.0.0.0/0, ::/0").split(",")
        return tuple(ipaddress.ip_network(each.strip()) for each in listed if each.strip())

    @field_validator("peers", mode="before")
    @classmethod
    def _read_peers(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        listed = [each.strip().rpartition(":") for each in value.split(",") if each.strip()]
        if not all(host and port.isdecimal() and 0 < int(port) < 2**16 for host, _, port in listed):
            raise ValueError("must be HOST:PORT, several by commas")
        return tuple((host.strip("[]"), int(port)) for host, _, port in listed)

    @field_validator("traces")
    @classmethod
    def _check_endpoint(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(r"https?://[^/\s]\S*", value):
            raise ValueError("must be an address such as http://collector:4318")
        return value


def load_settings(**overrides: Any) -> Settings:
    """Settings from flags, then the environment, then the defaults; None is a flag not given.

    Raises
    ------
    ConfigError
        If a value is out of range, or a ``NEURALMUSIC_`` variable or a flag is unknown.
    """
    given = {name: value for name, value in overrides.items() if value is not None}
    _refuse_unknown(os.environ)
    try:
        return Settings(**given)
    except ValidationError as error:
        raise ConfigError("; ".join(map(_sentence, error.errors()))) from None


def variable(name: str) -> str:
    """The environment variable of a setting."""
    return PREFIX + name.upper()


def flag(name: str) -> str:
    """The flag of a setting, of ``neuralmusic serve``."""
    return f"--{name.replace('_', '-')}"


def _refuse_unknown(environment: Mapping[str, str]) -> None:
    for name, value in environment.items():
        if not name.upper().startswith(PREFIX):
            continue
        if value.startswith(("tcp://", "udp://")) or name.startswith(PREFIX + "SERVICE_"):
            raise ConfigError(
                f"Kubernetes set {name} for a Service called neuralmusic: "
                "set enableServiceLinks: false in the pod"
            )
        field = name.upper().removeprefix(PREFIX).lower()
        if name == KEY_VARIABLE:
            # Clients on the same machine read it; a path in it was meant for `keys`.
            if value and TOKEN.fullmatch(value) is None:
                raise ConfigError(
                    f"{KEY_VARIABLE} holds no key: it takes a client's key, as neuralmusic key new "
                    f"prints it; the service's file of keys is {variable('keys')}"
                )
            continue
        if field not in Settings.model_fields:
            raise ConfigError(_unknown("variable", field, variable))


def _unknown(what: str, name: str, spell: Callable[[str], str]) -> str:
    """An error sentence for an unknown setting, spelt as a variable or a flag."""
    if name in RENAMED:
        return f"{spell(name)} is now {spell(RENAMED[name])}"
    known = list(Settings.model_fields)
    close = get_close_matches(name, known, n=1)
    hint = (
        f"did you mean {spell(close[0])}?" if close else f"there are {', '.join(map(spell, known))}"
    )
    return f"unknown {what} {spell(name)}: {hint}"


_RULES = {
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge}",
    "less_than_equal": "must be at most {le:g}",
    "literal_error": "must be one of {expected}",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_parsing": "must be a number",
}


def _sentence(error: ErrorDetails) -> str:
    name = str(error["loc"][0])
    if error["type"] == "extra_forbidden":
        return _unknown("flag", name, flag)
    rule = _RULES.get(error["type"])
    said = (
        rule.format(**error.get("ctx", {})) if rule else error["msg"].removeprefix("Value error, ")
    )
    return f"{name} {said}, but is {error['input']!r} (flag or {variable(name)})"
