"""Every experiment from the command line at the smallest scale, on synthetic voices."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model_export.__main__ import main
from model_export.cli.experiments import NAMES, experiments

pytestmark = [pytest.mark.torch, pytest.mark.learns]


def test_all_experiments_run_and_do_nothing_twice(
    corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    docs, runs = tmp_path / "docs", tmp_path / "runs"
    command = ["experiments", "all", "--scale", "smoke", "--speech-commands", str(corpus)]
    command += ["--runs", str(runs), "--out", str(docs)]
    assert main(command) == 0
    found = json.loads((docs / "comparison" / "findings.json").read_text())
    assert list(found) == list(NAMES) == list(experiments())
    text = (docs / "results.md").read_text()
    for outcome in found.values():
        for _, name in outcome["figures"]:
            assert (docs / "comparison" / name).stat().st_size > 1000
            assert f"(comparison/{name})" in text
    rows = {row[0]: row for row in found["main"]["tables"][0]["rows"]}
    assert len(rows) == 8 + 2 * 9 + 1 + 2
    done = {path: path.stat().st_mtime_ns for path in runs.rglob("*") if path.is_file()}
    capsys.readouterr()
    assert main([*command[:1], "main", *command[2:]]) == 0
    assert {path: path.stat().st_mtime_ns for path in done} == done
    assert "Main table" in capsys.readouterr().out
    assert main([*command[:1], "main", *command[2:-2], "--methods", "crnn", "music"]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows[1:4]] == ["| MUSIC", "| CRNN, cited", "| CRNN"]


def test_rows_that_are_no_methods_are_refused(
    corpus: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["experiments", "main", "--speech-commands", str(corpus)]
    assert main([*command, "--methods", "musik"]) == 2
    assert "no method is named 'musik'; the methods are music" in capsys.readouterr().err
    assert main([*command, "--methods", "music", "--out", "docs"]) == 2
    assert "--methods only prints" in capsys.readouterr().err
