"""Settings: flags over environment over defaults, and sentences for errors."""

from __future__ import annotations

import os
from ipaddress import ip_network
from pathlib import Path
from typing import Any

import pytest

from neuralmusic.cli import main
from neuralmusic.errors import ConfigError
from service.access.key_file import new_token
from service.machine.cpus import usable_cpus
from service.settings import RENAMED, Settings, load_settings, variable


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("NEURALMUSIC_")]:
        monkeypatch.delenv(name)


def test_defaults_are_for_a_developer_on_one_machine() -> None:
    settings = load_settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8000)
    assert settings.workers == usable_cpus()
    assert settings.max_upload_bytes == 512 * 2**20


def test_a_flag_wins_over_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALMUSIC_PORT", "9000")
    monkeypatch.setenv("NEURALMUSIC_QUEUE", "3")
    settings = load_settings(port=9001, queue=None)
    assert (settings.port, settings.queue) == (9001, 3)


def test_model_folders_are_separated_as_in_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALMUSIC_MODELS", f"/opt/a{os.pathsep}/opt/b")
    assert load_settings().models == (Path("/opt/a"), Path("/opt/b"))
    assert load_settings(models=[Path("/c")]).models == (Path("/c"),)


def test_an_empty_variable_is_one_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALMUSIC_PORT", "")
    assert load_settings().port == 8000


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("NEURALMUSIC_PORT", "70000", "port must be at most 65535, but is '70000'"),
        ("NEURALMUSIC_PORT", "http", "port must be a whole number, but is 'http'"),
        ("NEURALMUSIC_WORKERS", "0", "workers must be at least 1, but is '0'"),
        ("NEURALMUSIC_WORKERS", "1.5", "workers must be a whole number, but is '1.5'"),
        ("NEURALMUSIC_MAX_SECONDS", "0", "max_seconds must be greater than 0"),
        ("NEURALMUSIC_MAX_SECONDS", "nan", "max_seconds must be at most 86400"),
        ("NEURALMUSIC_MAX_SECONDS", "an hour", "max_seconds must be a number"),
        ("NEURALMUSIC_PEERS", "neuralmusic", "peers must be HOST:PORT, several by commas"),
        ("NEURALMUSIC_PEERS", "a:8000,b:0", "peers must be HOST:PORT"),
        ("NEURALMUSIC_LOG_LEVEL", "loud", "log_level must be one of 'critical', 'error'"),
        ("NEURALMUSIC_MAX_UPLOAD", "1", "did you mean NEURALMUSIC_MAX_UPLOAD_BYTES?"),
        ("NEURALMUSIC_PROT", "", "did you mean NEURALMUSIC_PORT?"),
        ("NEURALMUSIC_XYZZY", "1", "there are NEURALMUSIC_HOST, NEURALMUSIC_PORT, "),
        ("NEURALMUSIC_KEY", "/etc/keys", "the service's file of keys is NEURALMUSIC_KEYS"),
        ("NEURALMUSIC_PORT", "tcp://10.0.0.1:80", "enableServiceLinks: false"),
        ("NEURALMUSIC_SERVICE_HOST", "10.0.0.1", "enableServiceLinks: false"),
    ],
)
def test_a_wrong_variable_is_refused_with_a_sentence(
    name: str, value: str, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError) as caught:
        load_settings()
    assert sentence in caught.value.detail


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        ({"port": -1}, "port must be at least 0, but is -1 (flag or NEURALMUSIC_PORT)"),
        ({"traces": "collector:4317"}, "traces must be an address such as http://collector:4318"),
        ({"prot": 1}, "unknown flag --prot: did you mean --port?"),
        ({"port": -1, "queue": -1}, "; queue must be at least 0"),
    ],
)
def test_a_wrong_flag_is_refused_with_a_sentence(flags: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_settings(**flags)
    assert sentence in caught.value.detail


RENAMINGS = [
    ("NEURALMUSIC_THREADS", "NEURALMUSIC_PROCESSES"),
    ("NEURALMUSIC_STALL_TIMEOUT", "NEURALMUSIC_STALL_TIMEOUT_S"),
    ("NEURALMUSIC_BODY_TIMEOUT", "NEURALMUSIC_BODY_TIMEOUT_S"),
    ("NEURALMUSIC_STREAM_BUFFER", "NEURALMUSIC_STREAM_BUFFER_S"),
    ("NEURALMUSIC_IDLE_TIMEOUT", "NEURALMUSIC_IDLE_TIMEOUT_S"),
    ("NEURALMUSIC_MAX_SESSION", "NEURALMUSIC_MAX_SESSION_S"),
    ("NEURALMUSIC_DRAIN_DELAY", "NEURALMUSIC_DRAIN_DELAY_S"),
    ("NEURALMUSIC_DRAIN_GRACE", "NEURALMUSIC_DRAIN_GRACE_S"),
]


@pytest.mark.parametrize(("old", "new"), RENAMINGS)
def test_a_setting_under_its_old_name_is_refused_with_the_new_one(
    old: str, new: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = [
        f"--{name.removeprefix('NEURALMUSIC_').lower().replace('_', '-')}" for name in (old, new)
    ]
    assert main(["serve", flags[0], "5"]) == 2
    assert capsys.readouterr().err == f"error: {flags[0]} is now {flags[1]}\n"
    monkeypatch.setenv(old, "5")
    with pytest.raises(ConfigError) as caught:
        load_settings()
    assert caught.value.detail == f"{old} is now {new}"


def test_all_old_names_are_tried_and_lead_to_settings() -> None:
    assert {(variable(old), variable(new)) for old, new in RENAMED.items()} == set(RENAMINGS)
    assert set(RENAMED.values()) <= Settings.model_fields.keys()


def test_times_have_their_unit_in_their_names() -> None:
    times = [name for name, field in Settings.model_fields.items() if field.annotation is float]
    assert [name for name in times if not name.endswith(("_s", "_seconds"))] == []
    assert "drain_delay_s" in times


def test_every_setting_can_be_set_by_its_variable_and_says_what_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    examples = {"host": "::1", "models": "/m", "default_model": "w", "log_level": "debug"}
    examples |= {"log_format": "json", "traces": "http://collector:4318"}
    examples |= {"hosts": "robot.local, doa.example", "keys": "/k"}
    examples |= {"peers": "neuralmusic:8000, [::1]:9000,"}
    examples |= {"proxies": "10.0.0.0/8, 192.0.2.1", "stream_bytes_per_s": "65536"}
    examples |= {"noise_folder": "/n", "stream_buffer_s": "2.5", "origins": "http://a,http://b"}
    for name, field in Settings.model_fields.items():
        assert field.description, name
        monkeypatch.setenv(variable(name), examples.get(name, "2048"))
    monkeypatch.setenv("NEURALMUSIC_WORKERS", "7")
    monkeypatch.setenv("NEURALMUSIC_STREAM_WORKERS", "5")
    monkeypatch.setenv("NEURALMUSIC_PROCESSES", "3")
    monkeypatch.setenv("NEURALMUSIC_MAX_CHANNELS", "9")
    assert load_settings().model_dump() == {
        "host": "::1",
        "port": 2048,
        "models": (Path("/m"),),
        "default_model": "w",
        "workers": 7,
        "processes": 3,
        "queue": 2048,
        "stall_timeout_s": 2048.0,
        "max_upload_bytes": 2048,
        "body_timeout_s": 2048.0,
        "max_seconds": 2048.0,
        "max_channels": 9,
        "max_sessions": 2048,
        "max_sessions_per_client": 2048,
        "stream_workers": 5,
        "stream_frames_per_s": 2048.0,
        "stream_bytes_per_s": 65536.0,
        "max_connections": 2048,
        "max_connections_per_address": 2048,
        "proxies": (ip_network("10.0.0.0/8"), ip_network("192.0.2.1")),
        "stream_buffer_s": 2.5,
        "idle_timeout_s": 2048.0,
        "max_session_s": 2048.0,
        "origins": ("http://a", "http://b"),
        "peers": (("neuralmusic", 8000), ("::1", 9000)),
        "hosts": ("robot.local", "doa.example"),
        "keys": Path("/k"),
        "noise_folder": Path("/n"),
        "drain_delay_s": 2048.0,
        "drain_grace_s": 2048.0,
        "log_level": "debug",
        "log_format": "json",
        "traces": "http://collector:4318",
    }


def test_a_clients_key_is_no_setting_and_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    for value in (new_token(), ""):
        monkeypatch.setenv("NEURALMUSIC_KEY", value)
        assert load_settings().keys is None
