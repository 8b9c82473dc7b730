"""The bars judge hand-made results as a reader of the table would."""

from __future__ import annotations

import pytest

from model_export.evaluation.bars import BARS, Bar, bars_section, judge
from model_export.evaluation.cells import CELLS
from model_export.evaluation.false_sources import NOISES
from model_export.evaluation.methods import PEER
from model_export.evaluation.results import README_CELLS, Results


def scores(ours: float, peer: float, score: str = "maae_deg") -> dict:
    return {"cell": {"any-array": {score: ours}, PEER: {score: peer}}}


@pytest.mark.parametrize(
    ("bar", "ours", "peer", "met"),
    [
        (Bar("", ("cell",), limit=("at most", 0.4)), 0.4, 9.0, True),
        (Bar("", ("cell",), limit=("at most", 0.4)), 0.41, 9.0, False),
        (Bar("", ("cell",), limit=("at most", 0.4), share=0.3), 0.39, 1.4, True),
        (Bar("", ("cell",), limit=("at most", 0.4), share=0.3), 0.39, 1.2, False),
        (Bar("", ("cell",), share=1.0), 0.0, 0.0, True),
        (Bar("", ("cell",), limit=("at least", 0.9)), 0.9, 1.0, True),
        (Bar("", ("cell",), limit=("at least", 0.9)), 0.89, 1.0, False),
        (Bar("", ("cell",), limit=("under", 0.05)), 0.05, 0.0, False),
    ],
)
def test_verdicts(bar: Bar, ours: float, peer: float, met: bool) -> None:
    assert judge(bar, scores(ours, peer)).met is met


def test_several_cells_count_by_their_mean() -> None:
    bar = Bar("", ("one", "two"), limit=("at most", 2.0))
    run = {"one": {"any-array": {"maae_deg": 1.0}}, "two": {"any-array": {"maae_deg": 3.0}}}
    verdict = judge(bar, run)
    assert (verdict.ours, verdict.peer, verdict.met) == (2.0, None, True)
    assert judge(bar, {"one": run["one"]}).met is None  # half the cells are no mean


def test_without_normmusic_a_share_of_it_is_not_judged() -> None:
    run = {"cell": {"any-array": {"maae_deg": 0.1}}}
    assert judge(Bar("", ("cell",), share=0.5), run).met is None


def test_every_bar_is_of_a_cell_that_is_run() -> None:
    names = {cell.name for cell in (*CELLS, *NOISES)}
    assert {cell for bar in BARS for cell in bar.cells} <= names
    assert all(bar.limit or bar.share for bar in BARS)


def test_the_section_says_who_is_judged_and_how() -> None:
    name = "M=1, order 4, 30 dB"
    found = {"any-array": 0.41, PEER: 1.30, "gcc_phat": 1.12}
    run = {name: {method: {"maae_deg": error} for method, error in found.items()}}
    section = bars_section(run)
    assert "`any-array`" in section
    assert "0 of 1 bars met" in section
    assert (
        f"| {name}: error | at most 0.40°, at most 0.3 of NormMUSIC's | 1.41° | 0.41° | 1.12° "
        "| 1.30° | 0.32 | **short** |"
    ) in section


def test_the_readme_has_a_column_for_every_method_that_ran() -> None:
    found = {method: {"maae_deg": 1.0} for method in ("gcc_phat", "any-array")}
    run = dict.fromkeys(README_CELLS, found)
    block = Results(scenes=5, seed=0, cells=run).readme_block()
    assert "| cell | any-array | gcc_phat |\n" in block
