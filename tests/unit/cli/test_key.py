"""``neuralmusic key``: what it prints is what the service takes."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import Any

import pytest
from command_line import refusal, run

from neuralmusic.cli.flags import given_key
from service.access.key_file import TOKEN, Key, new_token, read_keys
from service.access.keys import Keys

Capture = pytest.CaptureFixture[str]


def token_in(text: str) -> str:
    found = re.search(TOKEN, text)
    assert found is not None
    return found.group()


def test_a_new_key_opens_what_it_was_made_for(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "keys.jsonl"
    tokens = {}
    for name, roles in (("robot-1", "stream"), ("ops", "watch, admin")):
        code, out, _ = run(capsys, "key", "new", name, "--roles", roles, "--file", str(file))
        assert code == 0
        tokens[name] = token_in(out)
        assert tokens[name] not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    keys = Keys(file)
    for name, token in tokens.items():
        assert keys.authenticate(token).name == name
    assert keys.authenticate(tokens["ops"]).roles == ("watch", "admin")


def test_limits_and_dates_are_in_the_line(capsys: Capture) -> None:
    flags: dict[str, Any] = {
        "--max-sessions": 2,
        "--max-uploads": 3,
        "--audio-seconds-per-hour": 1800.5,
        "--origins": "https://a.example,https://b.example",
        "--expires": "2030-01-31",
    }
    argv = [str(word) for pair in flags.items() for word in pair]
    _, out, _ = run(capsys, "key", "new", "n", "--roles", "localize", *argv)
    key = Key.model_validate_json(out.split("line:")[1])
    assert (key.max_sessions, key.max_uploads, key.audio_seconds_per_hour) == (2, 3, 1800.5)
    assert key.origins == ("https://a.example", "https://b.example")
    assert key.expires is not None
    assert key.expires.isoformat() == "2030-01-31T00:00:00+00:00"


def test_a_file_that_ends_without_a_newline_gets_a_line_of_its_own(
    tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "keys.jsonl"
    run(capsys, "key", "new", "a", "--roles", "stream", "--file", str(file))
    file.write_text("# ours\n" + file.read_text().rstrip("\n"))
    run(capsys, "key", "new", "b", "--roles", "stream", "--file", str(file))
    assert [key.name for key in read_keys(file)] == ["a", "b"]


@pytest.mark.parametrize(
    ("argv", "reason"),
    [
        (["new", "my robot", "--roles", "stream"], "name: String should match"),
        (["new", "r", "--roles", "root"], "roles: Input should be 'localize'"),
        (["new", "r", "--roles", ","], "roles"),
        (["new", "r", "--roles", "stream", "--max-sessions", "-1"], "max_sessions"),
        (["new", "r", "--roles", "stream", "--expires", "soon"], "--expires must be a date"),
        (["list", "none.jsonl"], "none.jsonl cannot be read"),
    ],
)
def test_what_is_wrong_is_one_sentence(argv: list[str], reason: str, capsys: Capture) -> None:
    assert reason in refusal(capsys, "key", *argv)


def test_a_file_of_comments_alone_gets_its_first_key(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "keys.jsonl"
    file.write_text("# our keys\n")
    file.chmod(0o600)
    code, _, _ = run(capsys, "key", "new", "robot", "--roles", "stream", "--file", str(file))
    assert (code, [key.name for key in read_keys(file)]) == (0, ["robot"])


def test_the_list_says_which_keys_have_expired_and_in_which_zone(
    tmp_path: Path, capsys: Capture
) -> None:
    file = str(tmp_path / "keys.jsonl")
    for name, date in (("old", "2020-01-31"), ("new", "2200-01-31T05:00+05:00")):
        run(capsys, "key", "new", name, "--roles", "stream", "--file", file, "--expires", date)
    _, out, _ = run(capsys, "key", "list", file)
    assert "2020-01-31 00:00 UTC (expired)" in out
    assert "2200-01-31 00:00 UTC " in out
    assert out.count("(expired)") == 1


def test_a_name_is_given_once(tmp_path: Path, capsys: Capture) -> None:
    argv = ["key", "new", "r", "--roles", "stream", "--file", str(tmp_path / "k")]
    run(capsys, *argv)
    before = (tmp_path / "k").read_text()
    assert "has a key r" in refusal(capsys, *argv)
    assert (tmp_path / "k").read_text() == before


def test_the_list_shows_names_and_limits_and_no_whole_hash(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "k"
    argv = ["--roles", "stream,watch", "--max-sessions", "2", "--file", str(file)]
    run(capsys, "key", "new", "robot-1", *argv)
    code, out, _ = run(capsys, "key", "list", str(file))
    assert code == 0
    assert "robot-1" in out
    assert "stream, watch" in out
    (key,) = read_keys(file)
    assert key.sha256[:8] in out
    assert key.sha256 not in out


def test_commands_take_a_key_itself_a_file_or_the_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = new_token(), new_token()
    monkeypatch.delenv("NEURALMUSIC_KEY", raising=False)
    assert given_key(None) is None
    monkeypatch.setenv("NEURALMUSIC_KEY", one)
    assert given_key(None) == one
    (tmp_path / "key").write_text(f"{two}\n")
    assert given_key(f"@{tmp_path / 'key'}") == two
    assert given_key(two) == two
