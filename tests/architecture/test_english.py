"""Attribute docstrings name their thing; they do not begin in the middle of a sentence."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from source_tree import ROOT

FOLDERS = ("client", "service", "model_export", "tests")
FRAGMENT = re.compile(
    r"(Of|That|Whose|As|By|With|Where|When|(In|From|To|At|On|After|Before|Until) which)\b"
)
"""Beginnings that name nothing: ``Of the channels`` instead of ``Number of channels``"""


def test_attribute_docstrings_name_their_thing() -> None:
    fragments = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in attribute_docstrings(path)
        if FRAGMENT.match(text)
    ]
    assert not fragments, "\n".join(fragments)


def test_a_fragment_is_found(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text('CHANNELS = 4\n"""Of the array"""\nclass A:\n    n: int\n    """Samples"""\n')
    found = [text for _, text in attribute_docstrings(module)]
    assert found == ["Of the array", "Samples"]
    assert [text for text in found if FRAGMENT.match(text)] == ["Of the array"]


def attribute_docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Lines and texts of the strings after a module's assignments."""
    for node in ast.walk(ast.parse(path.read_text())):
        body = getattr(node, "body", None)
        for assignment, docstring in pairwise(body if isinstance(body, list) else ()):
            match assignment, docstring:
                case ast.Assign() | ast.AnnAssign(), ast.Expr(ast.Constant(str(text))):
                    yield docstring.lineno, text.strip()
