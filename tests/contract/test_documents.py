"""What the documents say is what the program and its results say."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import get_args

from model_export.cli.experiments import NAMES, RECORDINGS
from model_export.evaluation.results import Results
from model_export.evaluation.sections import kept_section, marked
from model_export.experiments.report import section
from model_export.experiments.scale import SCALES
from neuralmusic import client_errors  # noqa: F401  (part of the tree)
from neuralmusic.errors import DoaError
from service.doa.diagnostics import FindingCode
from service.inference.bundle import load_bundle, read_manifest
from service.settings import KEY_VARIABLE, Settings, variable

ROOT = Path(__file__).parents[2]
RESULTS = Results.read(ROOT / "docs" / "results.json")


def test_the_result_tables_are_those_of_the_results() -> None:
    comparison = section(ROOT / "docs", [*NAMES, *RECORDINGS], asdict(SCALES["small"]))
    written = (ROOT / "docs" / "results.md").read_text()
    assert written == f"{RESULTS.document()}\n{marked('comparison', comparison)}\n"


def test_the_table_of_the_readme_is_that_of_the_results() -> None:
    written = kept_section(ROOT / "README.md", "results")
    assert written == marked("results", RESULTS.readme_block()) + "\n"


def test_the_bundle_carries_the_results() -> None:
    manifest, _ = read_manifest(ROOT / "service" / "models" / "any-array")
    assert manifest.scores == RESULTS.bundle_scores("any-array")


def test_the_bundle_carries_its_model_card() -> None:
    card = (ROOT / "docs" / "models" / "any-array.md").read_text()
    assert load_bundle(ROOT / "service" / "models" / "any-array").card == card


def test_variables_that_documents_name_exist() -> None:
    known = {variable(name) for name in Settings.model_fields} | {KEY_VARIABLE}
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        assert set(re.findall(r"NEURALMUSIC_[A-Z_]+", page.read_text())) <= known


def test_every_make_target_of_the_readme_exists() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in ("README.md", "CONTRIBUTING.md"):
        assert (
            set(re.findall(r"^make ([a-z]+)", (ROOT / page).read_text(), re.MULTILINE)) <= targets
        )


def subclasses(error: type[DoaError]) -> set[type[DoaError]]:
    found = set(error.__subclasses__())
    return found.union(*(subclasses(child) for child in found))


def test_every_code_is_documented() -> None:
    text = (ROOT / "docs" / "errors.md").read_text()
    leaves = {error for error in subclasses(DoaError) if not error.__subclasses__()}
    for error in leaves:
        assert f"`{error.code}`" in text, error
    for code in get_args(FindingCode):
        assert f"`{code}`" in text
