"""Parts of documents that commands write, each between markers of its own."""

from __future__ import annotations

from pathlib import Path


def marked(name: str, text: str) -> str:
    """The text between the markers of the section ``name``."""
    begin, end = _markers(name)
    return f"{begin}\n{text}{end}"


def renew(document: Path, name: str, text: str) -> None:
    """Put the section into the document, in place of the old one or at its end."""
    old = document.read_text() if document.exists() else ""
    begin, end = _markers(name)
    if begin in old:
        before, after = old.split(begin)[0], old.split(end)[1]
    else:
        before, after = old.rstrip("\n") + "\n\n" if old else "", "\n"
    document.write_text(before + marked(name, text) + after)


def kept_section(document: Path, name: str) -> str:
    """The section with its markers, as it stands in a document; empty where there is none."""
    old = document.read_text() if document.exists() else ""
    begin, end = _markers(name)
    if begin not in old:
        return ""
    return begin + old.split(begin)[1].split(end)[0] + end + "\n"


def _markers(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
