"""The documents' links lead somewhere, their commands parse, and the index has every page."""

from __future__ import annotations

import argparse
import re
import shlex
from functools import cache
from pathlib import Path

import pytest

from model_export import cli

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted(DOCS.rglob("*.md")),
    *(ROOT / room / "README.md" for room in ("client", "examples", "model_export")),
]
FENCES = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)\s]*))?\)")


def text_of(page: Path) -> str:
    """The page without its blocks of code."""
    return FENCES.sub("", page.read_text())


@cache
def anchors(page: Path) -> frozenset[str]:
    """The names that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", each).lower().replace(" ", "-") for each in headings)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_page_and_its_heading(page: Path) -> None:
    for target, anchor in LINK.findall(text_of(page)):
        found = (page.parent / target).resolve() if target else page
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), f"{target}#{anchor}"


def test_the_index_has_every_page_once() -> None:
    rows = re.findall(r"^\| \[[^]]+\]\((\S+\.md)\) \| \S", (DOCS / "README.md").read_text(), re.M)
    indexed = sorted(row for row in rows if not row.startswith("../"))
    pages = sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
    assert indexed == [page for page in pages if page != "README.md"]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_commands_of_the_training_side_parse() -> None:
    parser = argparse.ArgumentParser()
    cli.add_commands(parser.add_subparsers(required=True))
    blocks = "".join("".join(FENCES.findall(page.read_text())) for page in PAGES)
    commands = re.findall(r"python -m model_export ((?:[^\n#]*\\\n)*[^\n#]*)", blocks)
    assert len(commands) > 20
    for command in commands:
        parser.parse_args(shlex.split(command.replace("\\\n", " ")))
