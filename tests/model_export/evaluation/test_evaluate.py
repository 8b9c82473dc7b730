"""The evaluation runs every method on the same scenes and writes its tables and figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import model_export.evaluation.evaluate
from model_export.__main__ import main
from model_export.datasets.speech import load, speech_commands
from model_export.evaluation import figures
from model_export.evaluation.cells import CELLS, SHORT_CELL
from model_export.evaluation.evaluate import SEEDS, run
from model_export.evaluation.false_sources import NOISES
from model_export.evaluation.methods import PEER, Methods
from model_export.evaluation.results import TITLES, Results
from model_export.evaluation.workers import Inputs, Workers
from service.inference.registry import EMBEDDED_MODELS

ANY_ARRAY = EMBEDDED_MODELS / "any-array"


@pytest.fixture
def command(corpus: Path) -> list[str]:
    bundle = ["--bundle", str(ANY_ARRAY), "--speech-commands", str(corpus)]
    return ["evaluate", *bundle, "--scenes", "1", "--workers", "2"]


SHORT_NOISES = [replace(noise, seconds=1.5) for noise in NOISES]


def _ends(sweep: figures.Sweep) -> figures.Sweep:
    """A sweep's first and last point."""
    points = list(sweep.points.items())
    return replace(sweep, points=dict(points[:: len(points) - 1]))


@pytest.fixture(scope="module")
def evaluated(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with README.md and docs/ of a whole run by two processes."""
    folder = tmp_path_factory.mktemp("evaluated")
    readme = folder / "README.md"
    readme.write_text("before <!-- results: begin --> old <!-- results: end --> after")
    command = ["evaluate", "--bundle", str(ANY_ARRAY), "--speech-commands", str(corpus)]
    command += ["--scenes", "1", "--workers", "2", "--out", str(folder / "docs")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_export.evaluation.evaluate, "NOISES", SHORT_NOISES)
        patch.setattr(figures, "SWEEPS", [_ends(sweep) for sweep in figures.SWEEPS])
        assert main([*command, "--figures", "1", "--readme", str(readme)]) == 0
    return folder


@pytest.mark.learns
def test_tables_and_figures_are_written(evaluated: Path) -> None:
    out = evaluated / "docs"
    results = json.loads((out / "results.json").read_text())
    assert set(results["cells"]) == {cell.name for cell in (*CELLS, *SHORT_NOISES)}
    for cell in CELLS:
        scores = results["cells"][cell.name]
        assert set(scores) == {"any-array", "norm_music", "music", "srp_phat", "gcc_phat", PEER}
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
    text = (evaluated / "README.md").read_text()
    assert text.startswith("before <!-- results: begin -->\n")
    assert text.endswith("<!-- results: end --> after")
    assert " old " not in text


def test_a_part_of_the_evaluation_is_printed(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                *command,
                "--cells",
                "M=2, order 4, 30 dB*",
                "--split",
                "development",
                "--workers",
                "1",
            ]
        )
        == 0
    )
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
        (["--cells", "M=9*"], "no cell matches 'M=9*'; the cells are M=1, order 4, 30 dB"),
    ],
)
def test_what_would_leave_half_a_truth_is_refused(
    flags: list[str], says: str, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, *flags]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.learns
def test_the_number_of_workers_changes_nothing(evaluated: Path, corpus: Path) -> None:
    by_two = Results.read(evaluated / "docs" / "results.json")
    speech = load(speech_commands(corpus, "heldout"))
    inputs = Inputs(Methods([ANY_ARRAY]), speech, SEEDS["heldout"])
    with Workers.start(inputs) as workers:
        alone = run(workers, 1, cells=[CELLS[0], SHORT_CELL])
    assert list(alone.cells) == [CELLS[0].name, SHORT_CELL.name]
    for name, scores in alone.cells.items():
        assert scores == by_two.cells[name]
    assert alone.protocols[SHORT_CELL.name]["num_samples"] == 8000


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
