"""The bars: bounds on the embedded model's scores, and whether a run meets them.

A bar bounds the mean of one score over its cells, as a number, as a share of NormMUSIC's mean, or
both. The paper's figure stands beside it where the paper has one.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from model_export.evaluation.cells import (
    ARRAY_CELLS,
    PAPER_CELLS,
    ROOM_CELLS,
    SHORT_CELL,
    TALKER_CELLS,
)
from model_export.evaluation.false_sources import NOISES
from model_export.evaluation.methods import PEER
from model_export.simulation.arrays import TEST_ARRAYS

JUDGED = "any-array"
"""Name of the bundle that the service uses unless a request names another"""

Scores = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Values by cell, method and score, as in ``Results.cells``"""
Relation = Literal["at most", "at least", "under"]
RELATIONS: Mapping[Relation, Callable[[float, float], bool]] = {
    "at most": operator.le,
    "at least": operator.ge,
    "under": operator.lt,
}
UNITS = {"maae_deg": "°", "false_sources_per_minute": " a minute"}
"""Units of the scores that are not shares"""
WORDS = {
    "maae_deg": "error",
    "count_accuracy": "count right",
    "missed_talkers": "missed talkers",
    "within_10deg": "within 10°",
    "unanswered": "unanswered",
    "false_sources_per_minute": "false sources",
}


@dataclass(frozen=True, slots=True)
class Bar:
    """A bound on one score of one or several cells."""

    name: str
    cells: tuple[str, ...]
    score: str = "maae_deg"
    limit: tuple[Relation, float] | None = None
    """Bound on the mean over the cells"""
    share: float | None = None
    """Largest allowed ratio to NormMUSIC's mean over the cells"""
    paper: float | None = None
    """The paper's figure, where there is one"""


@dataclass(frozen=True, slots=True)
class Verdict:
    """A bar and a run's scores for it; None where the run lacks a cell or a method."""

    bar: Bar
    ours: float | None
    peer: float | None
    gcc_phat: float | None
    met: bool | None


def judge(bar: Bar, scores: Scores, model: str = JUDGED) -> Verdict:
    """Compare a run's scores with one bar."""
    ours, peer, gcc_phat = (_mean(bar, scores, method) for method in (model, PEER, "gcc_phat"))
    if ours is None or (bar.share is not None and peer is None):
        return Verdict(bar, ours, peer, gcc_phat, None)
    met = True
    if bar.limit is not None:
        relation, bound = bar.limit
        met = RELATIONS[relation](ours, bound)
    if bar.share is not None and peer is not None:
        met = met and ours <= bar.share * peer
    return Verdict(bar, ours, peer, gcc_phat, met)


def bars_section(scores: Scores, model: str = JUDGED) -> str:
    """A sentence that counts the bars that are met, and a Markdown table with a row per bar.

    Bars of cells that the evaluation did not run are left out.
    """
    ran = [bar for bar in BARS if any(cell in scores for cell in bar.cells)]
    verdicts = [judge(bar, scores, model) for bar in ran]
    met = sum(verdict.met is True for verdict in verdicts)
    lines = [
        f"The bundle `{model}`, the service's default: {met} of {len(verdicts)} bars met.",
        "NormMUSIC is pyroomacoustics', as below. It is told the number of talkers in every cell;",
        "the bundle and the service's GCC-PHAT are told it only where the cell does not say",
        '"count unknown".',
        "",
        f"| bar | asked | paper | {model} | GCC-PHAT | NormMUSIC | share of NormMUSIC | verdict |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for verdict in verdicts:
        bar = verdict.bar
        columns = (
            f"{bar.name}: {WORDS[bar.score]}",
            _asked(bar),
            _shown(bar.score, bar.paper),
            _shown(bar.score, verdict.ours),
            _shown(bar.score, verdict.gcc_phat),
            _shown(bar.score, verdict.peer),
            _ratio(verdict),
            {True: "met", False: "**short**", None: "–"}[verdict.met],
        )
        lines.append("| " + " | ".join(columns) + " |")
    return "\n".join(lines) + "\n"


def _mean(bar: Bar, scores: Scores, method: str) -> float | None:
    values = [scores.get(cell, {}).get(method, {}).get(bar.score) for cell in bar.cells]
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def _asked(bar: Bar) -> str:
    asked = []
    if bar.limit is not None:
        asked.append(f"{bar.limit[0]} {_shown(bar.score, bar.limit[1])}")
    if bar.share is not None:
        asked.append(f"at most {bar.share:g} of NormMUSIC's")
    return ", ".join(asked)


def _shown(score: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}{UNITS[score]}" if score in UNITS else f"{100 * value:.1f} %"


def _ratio(verdict: Verdict) -> str:
    """Ratio of our score to NormMUSIC's, for scores where less is better."""
    bounded = verdict.bar.share is not None or verdict.bar.score == "maae_deg"
    if not bounded or verdict.ours is None or not verdict.peer:
        return "–"
    return f"{verdict.ours / verdict.peer:.2f}"


def _talkers() -> tuple[Bar, ...]:
    bars: list[Bar] = []
    for cell, share in zip(TALKER_CELLS, (0.90, 0.95, 0.90, 0.60, 0.60, 0.50), strict=True):
        bars.append(Bar(cell.name, (cell.name,), "count_accuracy", ("at least", share)))
        bars.append(Bar(cell.name, (cell.name,), "missed_talkers", share=1.0))
    return tuple(bars)


_ONE, _ONE_0_DB, _TWO, _TWO_ANY_ORDER, _ONE_UNKNOWN, _TWO_UNKNOWN = (c.name for c in PAPER_CELLS)
_SMALL, _LARGE = (cell.name for cell in ROOM_CELLS)

BARS = (
    Bar(_ONE, (_ONE,), limit=("at most", 0.4), share=0.3, paper=1.41),
    Bar(_ONE_0_DB, (_ONE_0_DB,), limit=("at most", 2.5), share=0.45, paper=5.29),
    Bar(_TWO, (_TWO,), limit=("at most", 2.25), share=0.15, paper=2.25),
    Bar(_TWO_ANY_ORDER, (_TWO_ANY_ORDER,), limit=("at most", 2.0), share=0.2),
    Bar(
        "M=1 and M=2, count unknown",
        (_ONE_UNKNOWN, _TWO_UNKNOWN),
        limit=("at most", 2.14),
        paper=2.14,
    ),
    Bar(_ONE_UNKNOWN, (_ONE_UNKNOWN,), "count_accuracy", ("at least", 0.989), paper=0.989),
    Bar(_TWO_UNKNOWN, (_TWO_UNKNOWN,), "count_accuracy", ("at least", 0.995), paper=0.995),
    Bar(_SMALL, (_SMALL,), limit=("at most", 2.20), share=0.6, paper=2.20),
    Bar(_LARGE, (_LARGE,), limit=("at most", 1.71), share=0.6, paper=1.71),
    *(
        Bar(cell.name, (cell.name,), share=0.7)
        for cell in ARRAY_CELLS
        if cell.protocol.array in TEST_ARRAYS
    ),
    *_talkers(),
    Bar(SHORT_CELL.name, (SHORT_CELL.name,), "within_10deg", ("at least", 0.88)),
    Bar(SHORT_CELL.name, (SHORT_CELL.name,), "unanswered", ("under", 0.05)),
    *(
        Bar(noise.name, (noise.name,), "false_sources_per_minute", ("at most", 1.0))
        for noise in NOISES
    ),
)
