"""The outcomes in the documents: kept as JSON, renewed between markers, kept by other commands."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from model_export.evaluation.results import Results
from model_export.evaluation.sections import kept_section, renew
from model_export.experiments.outcome import Outcome, Table
from model_export.experiments.report import SECTION, keep, section
from model_export.experiments.scale import SCALES

pytestmark = pytest.mark.torch

FINDING = Outcome("Words.", (Table(("method", "M=1"), (("MUSIC", 3.961), ("other", None))),))
SCALE = asdict(SCALES["small"])


def test_a_finding_is_the_same_after_the_file(tmp_path: Path) -> None:
    keep(tmp_path, "main", "Main table", "the command", "small", FINDING)
    text = section(tmp_path, ["main"], SCALE)
    assert "### Main table\n\n`the command`\n\nWords." in text
    assert "| MUSIC | 3.96 |\n| other | – |" in text
    assert "2400" in text


def test_findings_stand_in_the_documents_order(tmp_path: Path) -> None:
    keep(tmp_path, "second", "Second", "c", "small", FINDING)
    keep(tmp_path, "first", "First", "c", "small", FINDING)
    text = section(tmp_path, ["first", "missing", "second"], SCALE)
    assert text.index("### First") < text.index("### Second")


def test_renewing_leaves_the_rest_of_the_document(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    document.write_text("# Results\n\nours\n")
    keep(tmp_path, "main", "Main table", "c", "small", FINDING)
    for title in ("Old", "New"):
        keep(tmp_path, "main", title, "c", "small", FINDING)
        renew(document, SECTION, section(tmp_path, ["main"], SCALE))
    text = document.read_text()
    assert text.startswith("# Results\n\nours\n")
    assert text.count("comparison: begin") == 1
    assert "### New" in text
    assert "### Old" not in text


def test_an_evaluation_leaves_the_comparison(tmp_path: Path) -> None:
    keep(tmp_path, "main", "Main table", "c", "small", FINDING)
    renew(tmp_path / "results.md", SECTION, section(tmp_path, ["main"], SCALE))
    kept = kept_section(tmp_path / "results.md", SECTION)
    Results(scenes=1, seed=7).write(tmp_path)
    text = (tmp_path / "results.md").read_text()
    assert "## Bars" in text
    assert kept in text
