"""Advice to install something can be followed from a clone: its folders and extras exist."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from source_tree import ROOT

import neuralmusic

ADVICE = re.compile(r"pip install((?: +(?:'[^'\n]+'|\"[^\"\n]+\"|[^\s'\"`),:;]+))+)")
WORDS = {"in", "or", "once", "for", "with", "beside", "while", "and", "#"}
"""End of a command within a sentence"""
PUBLISHED = {"neuralmusic": "client", "neuralmusic-service": "."}
"""Distributions of the project and their folders"""
FOREIGN = {"soundfile"}
SENTENCE = re.compile(r"published", re.IGNORECASE)


def project(folder: str) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
    return found


def pages() -> Iterator[Path]:
    """Everything that a user reads: documents, and sources with their messages."""
    yield from ROOT.glob("*.md")
    yield ROOT / "client" / "README.md"
    for folder in ("docs", "examples", "model_export"):
        yield from (ROOT / folder).rglob("*.md")
    for folder in ("client", "service", "model_export", "examples"):
        yield from (ROOT / folder).rglob("*.py")


def advice(page: Path) -> Iterator[tuple[str, list[str]]]:
    """The lines of a page that say what to install, and what they name."""
    joined = re.sub(r"\"\s*\n\s*f?\"", "", page.read_text())  # sentences over several strings
    for line in joined.splitlines():
        for found in ADVICE.findall(line):
            if "--dry-run" in found:
                continue
            words = shlex.split(found)
            end = next((i for i, word in enumerate(words) if word in WORDS), len(words))
            yield line, words[:end]


def fault(words: list[str]) -> str:
    """Why nobody can follow a line; empty where it can be followed."""
    names = [word.partition("[")[0] for word in words]
    for word, name in zip(words, names, strict=True):
        folder = PUBLISHED.get(name, name.removeprefix("./"))
        if name in FOREIGN:
            continue
        if folder not in (".", "client"):
            return f"{name} is no distribution of the project"
        known = set(project(folder).get("optional-dependencies", {}))
        asked = set(filter(None, word.partition("[")[2].rstrip("]").split(",")))
        if not asked <= known:
            return f"{name} has no extra {asked - known}"
    if "." in names and "./client" not in names:
        return "the service needs the client of the same clone: pip install ./client ."
    return ""


LINES = [
    (str(page.relative_to(ROOT)), line.strip(), words)
    for page in pages()
    for line, words in advice(page)
]


def test_there_is_advice_in_documents_and_in_messages() -> None:
    places = {place.split("/")[0] for place, _, _ in LINES}
    assert {"README.md", "docs", "client", "service", "examples"} <= places


def test_all_advice_can_be_followed() -> None:
    faults = {f"{place}: {line}": why for place, line, words in LINES if (why := fault(words))}
    assert not faults


def test_what_is_not_published_yet_is_called_so() -> None:
    for place, line, words in LINES:
        if {word.partition("[")[0] for word in words} & set(PUBLISHED):
            text = (ROOT / place).read_text()
            assert SENTENCE.search(text), f"{place}: {line}"


@pytest.mark.parametrize(
    "line", ["neuralmusic[client]", "'.[client]' ./client", "'.[plot]'", "./server", "numpi"]
)
def test_advice_that_leads_nowhere_is_found(line: str) -> None:
    assert fault(shlex.split(line))


def test_both_distributions_are_of_one_version() -> None:
    needed = f"neuralmusic=={neuralmusic.__version__}"
    assert needed in {each.partition(";")[0] for each in project(".")["dependencies"]}
    for folder in PUBLISHED.values():
        text = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())
        home = ROOT / folder / text["tool"]["hatch"]["version"]["path"]
        assert home.samefile(ROOT / "client" / "neuralmusic" / "__init__.py")
    heading = next(
        line
        for line in (ROOT / "CHANGELOG.md").read_text().splitlines()
        if re.match(r"## \d", line)
    )
    assert heading.startswith(f"## {neuralmusic.__version__} - ")


def test_shared_requirements_agree() -> None:
    def by_name(lines: Iterable[str]) -> dict[str, str]:
        bare = [line.partition(";")[0] for line in lines]
        return {re.split(r"[<>=]", each)[0]: each for each in bare}

    ours = by_name(project(".")["dependencies"])
    extras = project("client")["optional-dependencies"].values()
    theirs = by_name(chain(project("client")["dependencies"], *extras))
    assert {name: ours.get(name, each) for name, each in theirs.items()} == theirs


def test_the_service_s_commands_are_those_that_the_client_expects() -> None:
    from neuralmusic.cli.commands import GROUP, OF_THE_SERVICE

    points = project(".")["entry-points"][GROUP]
    assert points == {name: f"service.cli.{name}" for name in OF_THE_SERVICE}
