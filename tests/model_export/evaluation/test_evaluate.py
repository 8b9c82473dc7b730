"""The evaluation runs every method on the same scenes and writes its tables and figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import model_export.evaluation.evaluate
from model_export.__main__ import main
from model_export.evaluation.cells import CELLS, SHORT_CELL
from model_export.evaluation.evaluate import run
from model_export.evaluation.false_sources import NOISES
from model_export.evaluation.methods import PEER, Methods
from model_export.evaluation.results import TITLES, Results
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.synthesis import synthetic_voice
from service.inference.registry import EMBEDDED_MODELS

ANY_ARRAY = EMBEDDED_MODELS / "any-array"


@pytest.fixture
def command(corpus: Path) -> list[str]:
    bundle = ["--bundle", str(ANY_ARRAY), "--speech-commands", str(corpus)]
    return ["evaluate", *bundle, "--scenes", "1", "--workers", "1"]


def test_tables_and_figures_are_written(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noises = [replace(noise, seconds=1.5) for noise in NOISES]
    monkeypatch.setattr(model_export.evaluation.evaluate, "NOISES", noises)
    readme = tmp_path / "README.md"
    readme.write_text("before <!-- results: begin --> old <!-- results: end --> after")
    out = tmp_path / "docs"
    command += ["--out", str(out), "--figures", "1", "--readme", str(readme)]
    assert main(command) == 0
    results = json.loads((out / "results.json").read_text())
    assert set(results["cells"]) == {cell.name for cell in (*CELLS, *noises)}
    for cell in CELLS:
        scores = results["cells"][cell.name]
        assert set(scores) == {"any-array", "norm_music", "music", "srp_phat", PEER}
    reported = {score for found in results["cells"].values() for score in found["any-array"]}
    assert set(TITLES) <= reported
    assert list(results["reliability"]) == ["any-array"]
    assert (out / "results.md").read_text() == Results.read(out / "results.json").document()
    assert sorted(path.name for path in out.glob("*.png")) == [
        "error-over-rt60.png",
        "error-over-separation.png",
        "error-over-snr.png",
        "reliability.png",
    ]
    text = readme.read_text()
    assert text.startswith("before <!-- results: begin -->\n")
    assert text.endswith("<!-- results: end --> after")
    assert " old " not in text


def test_a_part_of_the_evaluation_is_printed(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--cells", "M=2, order 4, 30 dB*", "--split", "development"]) == 0
    out = capsys.readouterr().out
    rows = [line.split(" | ")[0] for line in out.split("## Mean absolute")[1].splitlines()]
    assert rows[4:6] == ["| M=2, order 4, 30 dB", "| M=2, order 4, 30 dB, count unknown"]
    assert "M=1, order 4, 0 dB" not in out.split("## Mean absolute")[1]


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--cells", "M=1*", "--write-scores"], "only print"),
        (["--split", "development", "--out", "somewhere"], "only print"),
        (["--readme", "README.md"], "need --out"),
        (["--cells", "M=9*"], "no cell is named like 'M=9*'; there are M=1, order 4, 30 dB"),
    ],
)
def test_what_would_leave_half_a_truth_is_refused(
    flags: list[str], says: str, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, *flags]) == 2
    assert says in capsys.readouterr().err


def test_the_number_of_workers_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    voices = [synthetic_voice(rng, 1.0) for _ in range(4)]
    found = []
    for count in (1, 2):
        with Workers.start(Inputs(Methods([ANY_ARRAY]), voices, seed=3), count) as workers:
            found.append(run(workers, 3, cells=[CELLS[0], SHORT_CELL]))
    assert found[0] == found[1]
    assert found[0].protocols[SHORT_CELL.name]["num_samples"] == 8000


def test_a_method_that_does_not_fit_a_cell_shows_as_a_dash() -> None:
    cells = {"square": {"paper": {"maae_deg": 1.0}, PEER: {"maae_deg": 2.0}}}
    cells |= {"ring": {PEER: {"maae_deg": 3.0}}, "silence": {PEER: {"false_sources": 0.0}}}
    table = Results(1, 7, cells=cells).tables().split("## Mean absolute")[1].splitlines()
    assert table[2:] == [
        f"| cell | paper | {PEER} |",
        "|---|---|---|",
        "| square | 1.00 | 2.00 |",
        "| ring | – | 3.00 |",
    ]
