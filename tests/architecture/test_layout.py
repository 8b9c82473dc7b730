"""How large the house may grow: few loose files, files a head can hold, no package unnamed."""

from __future__ import annotations

import pytest
from source_tree import FOLDERS, ROOT

LONGEST = 400
SOURCES = ("client", "service", "model_export", "tests")


@pytest.mark.parametrize(
    ("package", "most"), [("neuralmusic", 9), ("service", 9), ("model_export", 2)]
)
def test_few_files_lie_loose(package: str, most: int) -> None:
    loose = {path.name for path in FOLDERS[package].glob("*.py")} - {"__init__.py", "__main__.py"}
    assert len(loose) <= most, loose


def test_no_file_is_longer_than_a_head_holds() -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text().splitlines())
        for folder in SOURCES
        for kind in ("py", "js", "css", "html")
        for path in (ROOT / folder).rglob(f"*.{kind}")
    }
    assert lengths
    assert not {name: lines for name, lines in lengths.items() if lines > LONGEST}


def test_every_package_says_what_it_is() -> None:
    empty = [
        str(path.relative_to(ROOT))
        for folder in SOURCES
        for path in (ROOT / folder).rglob("__init__.py")
        if not path.read_text().strip()
    ]
    assert not empty
