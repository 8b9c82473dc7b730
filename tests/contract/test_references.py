"""``docs/cli.md`` and ``docs/python.md`` are the program's, and leave nothing out."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import neuralmusic
from neuralmusic.cli import main
from neuralmusic.cli.commands import OF_THE_SERVICE
from service.reference import commands, names

DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = (DOCS / "cli.md").read_text()
NAMES = (DOCS / "python.md").read_text()


def test_the_commands_are_the_program_s() -> None:
    assert commands.document() == COMMANDS, "run: make contracts"


def test_the_names_are_the_program_s() -> None:
    assert names.document() == NAMES, "run: make contracts"


@pytest.mark.parametrize("command", [*OF_THE_SERVICE, "stream", "arrays"])
def test_every_option_of_the_help_is_in_the_reference(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")  # no option is broken at its hyphens
    with pytest.raises(SystemExit):
        main([command, "--help"])
    helped = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out)) - {"--help"}
    (section,) = re.findall(
        rf"^## `neuralmusic {command}`\n(.*?)(?=^## |\Z)", COMMANDS, re.S | re.M
    )
    assert helped <= set(re.findall(r"--[a-z][a-z-]+", section))


def test_every_public_name_is_in_the_reference() -> None:
    assert {name for name in neuralmusic.__all__ if f"`{name}`" not in NAMES} == set()
    arguments = inspect.signature(neuralmusic.StreamClient).parameters
    assert {name for name in arguments if f"- `{name}`" not in NAMES} == {"backoff", "timeouts"}
