"""A hook of MkDocs: the site has the files outside docs/ that pages link to, in ``repository/``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

DOCS = Path(__file__).parent
ROOT = DOCS.parent
LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)[^)#\s]+")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what pages link to, and what these pages link to."""
    waiting = [page.abs_src_path for page in files.documentation_pages()]
    known = set(waiting)
    while waiting:
        for path in _linked(Path(waiting.pop() or "")):
            if path.is_relative_to(DOCS) or str(path) in known:
                continue
            known.add(str(path))
            added = File.generated(
                config, _uri(path), abs_src_path=str(path), inclusion=InclusionLevel.NOT_IN_NAV
            )
            files.append(added)
            if added.is_documentation_page():
                waiting.append(str(path))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links of and to files outside docs/ to their places on the site."""
    here = Path(page.file.abs_src_path or "")
    start = os.path.dirname(page.file.src_uri)
    return LINK.sub(
        lambda link: os.path.relpath(_uri((here.parent / link[0]).resolve()), start or "."),
        markdown,
    )


def _linked(page: Path) -> Iterator[Path]:
    for link in LINK.findall(page.read_text()):
        path = (page.parent / link).resolve()
        if path.is_file():
            yield path


def _uri(path: Path) -> str:
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    return f"repository/{path.relative_to(ROOT).as_posix()}"
